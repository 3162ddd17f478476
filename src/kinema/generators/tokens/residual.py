"""Complete base tokens by the residual layers' tokens, one layer per forward pass (MoMask §3, §4)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from kinema.decoding.draws import SeededDraws, TokenDraws
from kinema.generators import LatentModel
from kinema.generators.draws import StepDraws, share_of
from kinema.generators.tokens.choices import likely_choice
from kinema.generators.tokens.encoder import EMBEDDING_STD, TokenEncoder, guided_logits
from kinema.generators.tokens.request import check_codes
from kinema.nn.mode import inference
from kinema.nn.ranks import mean_over_ranks
from kinema.options import Classes, Depth, NonNegative, OpenShare, Options, Several, Share, Size, checked
from kinema.registry import buildable
from kinema.types import Known, Latents, LatentSpace, Losses, TextFeatures

NOTHING = -1
"""The code of a layer that adds nothing (PAD, once drawn)."""

STREAM = 1
"""Keeps the residual layers' draws apart from those of the base tokens."""


@buildable
@dataclass(frozen=True)
class ResidualSampling(Options):
    """Choose how residual tokens are sampled; the options mean what they mean in `MoMaskSampling`."""

    guidance: NonNegative = 5.0
    temperature: NonNegative = 1.0
    top_k: OpenShare = 0.9
    padding: bool = True


@dataclass
class ResidualDraws(StepDraws):
    """Hold what a training step draws: which layer each sample learns, and who loses the text."""

    layer: Float[Tensor, " b"]
    condition_drop: Bool[Tensor, " b"]

    @classmethod
    def draw(
        cls, samples: int, *, condition_drop: float, generator: torch.Generator | None, device: torch.device
    ) -> ResidualDraws:
        """Draw for `samples` samples."""
        layer, drop = torch.rand(2, samples, generator=generator, device=device)
        return cls(layer=layer, condition_drop=drop < condition_drop)


@buildable
class ResidualTransformer(LatentModel):
    """Predict the codes of residual layer q from the sum of the embedded codes of all layers below (MoMask §3).

    With `share_weights` (as released) layer p has one table, which embeds its codes and, from layer 1 on, scores them;
    without, embedding and scoring have tables of their own and scores a bias. Class `codebook_size` is PAD, which is
    no target; it is drawn only where `padding` of the sampling says so, as published, and then the layer adds nothing.
    """

    space: LatentSpace

    @checked
    def __init__(
        self,
        *,
        codebook_size: Classes,
        code_dim: Size,
        text_dim: Size,
        quantizers: Several,
        width: Size = 384,
        feedforward: Size = 1024,
        layers: Depth = 8,
        heads: Size = 6,
        dropout: OpenShare = 0.2,
        condition_drop: Share = 0.2,
        share_weights: bool = True,
        max_latents: Size = 49,
        downsample: Size = 4,
        sampling: ResidualSampling | None = None,
    ) -> None:
        super().__init__()
        self.text_dim = text_dim
        self.codebook_size = codebook_size
        self.quantizers = quantizers
        self.space = LatentSpace("codes", None, max_latents, downsample, codebook_size, quantizers)
        self.condition_drop = condition_drop
        self.sampling = sampling or ResidualSampling()
        classes, scored = codebook_size + 1, quantizers - 1
        self.tables = nn.Parameter(torch.empty(quantizers if share_weights else scored, classes, code_dim))
        self.score_tables = None if share_weights else nn.Parameter(torch.empty(scored, classes, code_dim))
        self.score_bias = None if share_weights else nn.Parameter(torch.zeros(scored, classes))
        self.layer_projection = nn.Linear(quantizers, width)
        self.encoder = TokenEncoder(
            code_dim=code_dim,
            text_dim=text_dim,
            outputs=code_dim,
            width=width,
            feedforward=feedforward,
            layers=layers,
            heads=heads,
            dropout=dropout,
        )
        for table in (self.tables, self.score_tables):
            if table is not None:
                nn.init.normal_(table, std=EMBEDDING_STD)

    def completes(self, base: LatentSpace) -> LatentSpace:
        """Return the codes that this makes of a base generator's; raises ValueError if it cannot complete them."""
        if base.quantizers != 1:
            raise ValueError(f"the base makes {base.quantizers} codes per position; give one that makes 1")
        own = self.space
        for option, ours, theirs in (
            ("codebook_size", own.codebook_size, base.codebook_size),
            ("max_latents", own.most, base.most),
            ("downsample", own.unit, base.unit),
        ):
            if ours != theirs:
                raise ValueError(
                    f"{option} is {theirs} in the base and {ours} in the residual transformer; train both on the same "
                    "tokenizer"
                )
        return replace(base, quantizers=self.quantizers)

    def history(self, codes: Int[Tensor, "b n q"], layer: Int[Tensor, " b"]) -> Float[Tensor, "b n d"]:
        """Sum the embedded codes of each sample's layers below `layer`."""
        below = torch.arange(self.quantizers - 1, device=codes.device) < layer[:, None]
        embedded = (self.tables[p][codes[..., p]] * below[:, p, None, None] for p in range(self.quantizers - 1))
        return sum(embedded, start=self.tables.new_zeros(()))

    def forward(
        self,
        history: Float[Tensor, "b n d"],
        text: Float[Tensor, "b t"],
        layer: Int[Tensor, " b"] | int,
        real: Bool[Tensor, "b n"],
    ) -> Float[Tensor, "b n k"]:
        """Return the logits of each sample's layer, PAD last; a zero text vector is the empty condition.

        One layer for all is a number: its table is read where it lies, that of a sample's own layer is copied.
        """
        number = torch.full((), layer, device=history.device) if isinstance(layer, int) else layer
        one_hot = nn.functional.one_hot(number, self.quantizers)
        condition = self.layer_projection(one_hot.to(history.dtype)).expand(len(history), -1)
        prefix = torch.stack((self.encoder.text_projection(text), condition), dim=1)
        x = self.encoder(self.encoder.embed(history, prefix), real=real)[:, 2:]
        if self.score_tables is None or self.score_bias is None:
            return x @ self.tables[layer].mT
        return x @ self.score_tables[layer - 1].mT + self.score_bias[layer - 1].unsqueeze(-2)

    def loss(
        self,
        latents: Latents,
        text: TextFeatures,
        *,
        generator: torch.Generator | None = None,
        shard: tuple[int, int] = (0, 1),
        draws: ResidualDraws | None = None,
    ) -> Losses:
        """Return the cross entropy and the accuracy of one drawn layer per sample, at all real positions (MoMask §3).

        Draws are made for the global batch, from `generator` (None: torch's own), of which this batch is the part
        `shard` = (rank, world); means are over the positions of all ranks. `draws` replaces them (tests).
        """
        codes = check_codes(latents, self.space)
        if draws is None:
            drop = self.condition_drop if self.training else 0.0
            draws = share_of(
                lambda samples: ResidualDraws.draw(
                    samples, condition_drop=drop, generator=generator, device=codes.device
                ),
                len(codes),
                shard,
            )
        layer, real = drawn_layer(draws.layer, self.quantizers), latents.mask
        pooled = text.pooled.masked_fill(draws.condition_drop[:, None], 0.0)
        logits = self(self.history(codes, layer), pooled, layer, real)[real]
        targets = codes.gather(2, layer[:, None, None].expand(-1, codes.shape[1], 1))[..., 0][real]
        rows = nn.functional.cross_entropy(logits.float(), targets, reduction="none")
        right = (logits.argmax(-1) == targets).float()
        return {"loss": mean_over_ranks(rows, shard[1]), "accuracy": mean_over_ranks(right, shard[1])}

    def complete(
        self,
        latents: Latents,
        text: TextFeatures,
        *,
        seeds: Int[Tensor, " b"],
        known: Known | None = None,
        sampling: ResidualSampling | None = None,
        draws: TokenDraws | None = None,
    ) -> Latents:
        """Add the codes of layers 1.. to base codes (b n 1), one forward pass per layer.

        Positions that `known.mask` keeps take the codes of `known` in every layer. A sample depends on its own seed
        only. `draws` replaces what the seeds draw, step q - 1 being layer q (tests).
        """
        sampling = sampling or self.sampling
        device = self.tables.device
        base, real = check_codes(latents, replace(self.space, quantizers=1)).to(device), latents.mask.to(device)
        codes = base.new_zeros(*base.shape[:2], self.quantizers)
        codes[..., 0] = base[..., 0]
        keep, given = self._kept(codes, known)
        pooled = text.pooled.to(device)
        choose = likely_choice(draws or SeededDraws(seeds, STREAM), sampling.temperature, sampling.top_k)
        with inference(self):
            history = self.tables.new_zeros(())
            for q in range(1, self.quantizers):
                history = history + self.tables[q - 1][codes[..., q - 1]]
                predict = partial(self._of_layer, q)
                logits = guided_logits(predict, history, pooled, real, scale=sampling.guidance).float()
                if not sampling.padding:
                    logits[..., self.codebook_size] = -torch.inf
                codes[..., q] = torch.where(keep, given[..., q], choose(q - 1, logits)).masked_fill(~real, 0)
        codes = codes.masked_fill(codes == self.codebook_size, NOTHING)
        return Latents(lengths=latents.lengths, frames=latents.frames, codes=codes)

    def _of_layer(self, layer: int, history: Tensor, text: Tensor, real: Tensor) -> Tensor:
        return self(history, text, layer, real)

    def _kept(self, codes: Int[Tensor, "b n q"], known: Known | None) -> tuple[Tensor, Tensor]:
        """Return the mask of the kept positions and the codes they have."""
        if known is None:
            return torch.zeros(codes.shape[:2], dtype=torch.bool, device=codes.device), codes
        source, nothing = known.latents, None
        if source.codes is not None:  # a layer that adds nothing is read as PAD, and drawn again as that
            layers = torch.arange(source.codes.shape[-1], device=source.codes.device)
            nothing = (source.codes == NOTHING) & (layers > 0) & source.mask[..., None]
            source = replace(source, codes=source.codes.masked_fill(nothing, 0))
        given = check_codes(source, self.space, known.mask.shape[1])
        if nothing is not None:
            given = given.masked_fill(nothing[..., : self.quantizers], self.codebook_size)
        positions = codes.shape[1]
        return known.mask[:, :positions].to(codes.device), given[:, :positions].to(codes.device)


def drawn_layer(uniform: Float[Tensor, " b"], quantizers: int) -> Int[Tensor, " b"]:
    """Turn uniform numbers into layers 1..quantizers-1, the lower ones more often (MoMask §3)."""
    return 1 + ((1 - torch.cos(math.pi / 2 * uniform)) * (quantizers - 2)).round().long()

"""Generate tokens by BAMM: from left to right behind the text, then half of them again between the other half."""

from __future__ import annotations

from typing import Annotated

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional as F

from kinema.decoding.draws import TokenDraws
from kinema.generators.bamm.sampling import BammSampling, SlotDecoder, Slots
from kinema.generators.bamm.training import BammDraws
from kinema.generators.draws import share_of
from kinema.generators.texts import check_guidance
from kinema.generators.tokens.encoder import TokenEncoder
from kinema.generators.tokens.residual import ResidualSampling
from kinema.generators.tokens.targets import per_sample, targets
from kinema.nn.mode import inference
from kinema.nn.ranks import mean_over_ranks
from kinema.nn.transformer import NORMS, TransformerBlock, initialize
from kinema.options import Classes, Depth, OneOf, OpenShare, Share, Size, checked
from kinema.registry import buildable
from kinema.types import Known, Latents, Losses, TextFeatures


def condition_mask(condition: Bool[Tensor, "b s"]) -> Bool[Tensor, "b m m"]:
    """Let the rows of [text, slots...] (m = 1 + s) see conditions and, unless they are conditions, what is before them.

    The text is always a condition. Row q sees column k if condition(k) or (not condition(q) and k <= q): BAMM, Hybrid
    attention.
    """
    condition = F.pad(condition, (1, 0), value=True)
    causal = torch.ones(condition.shape[1], condition.shape[1], dtype=torch.bool, device=condition.device).tril()
    return condition[:, None, :] | (~condition[:, :, None] & causal)


@buildable
class BAMM(Slots):
    """Predict slot p of [code 1, ..., code L, END] at position p of [text, slots], some slots being conditions (BAMM).

    norm="post" is the published network, "pre" its alternative (`t2mgpt`). Slots hold codes, END or PAD; there is no
    mask token.
    """

    predicts_length = True

    @checked
    def __init__(
        self,
        *,
        codebook_size: Classes,
        code_dim: Size,
        text_dim: Size,
        width: Size = 384,
        feedforward: Size = 1024,
        layers: Depth = 8,
        heads: Size = 6,
        dropout: OpenShare = 0.2,
        condition_drop: Share = 0.1,
        norm: Annotated[str, OneOf(NORMS)] = "post",
        max_latents: Size = 49,
        downsample: Size = 4,
        sampling: BammSampling | None = None,
    ) -> None:
        super().__init__(codebook_size=codebook_size, max_latents=max_latents, downsample=downsample)
        self.text_dim = text_dim
        self.end, self.pad = codebook_size, codebook_size + 1
        self.condition_drop = condition_drop
        self.sampling = sampling or BammSampling()
        self.token_embedding = nn.Embedding(codebook_size + 2, code_dim)
        nn.init.normal_(self.token_embedding.weight, std=0.02)
        self.encoder = TokenEncoder(
            code_dim=code_dim,
            text_dim=text_dim,
            outputs=codebook_size + 1,
            width=width,
            feedforward=feedforward,
            layers=layers,
            heads=heads,
            dropout=dropout,
            place_prefix=True,
        )
        if norm != "post":
            blocks = (TransformerBlock(width, heads, feedforward, dropout, norm=norm) for _ in range(layers))
            self.encoder.blocks = nn.ModuleList(blocks)
            initialize(self.encoder.blocks)
        self.check_sampling(self.sampling)

    def check_sampling(self, sampling: BammSampling) -> None:
        """Refuse guidance that training gave no ground."""
        super().check_sampling(sampling)
        scales = {"guidance": sampling.guidance, "second_guidance": sampling.second_guidance}
        check_guidance(self.condition_drop, **scales)

    def forward(
        self,
        ids: Int[Tensor, "b s"],
        text: Float[Tensor, "b t"],
        condition: Bool[Tensor, "b s"] | None = None,
        real: Bool[Tensor, "b s"] | None = None,
    ) -> Float[Tensor, "b m k"]:
        """Return m = 1 + s positions' logits of codes and END; position p predicts slot p. None: no conditions.

        A zero text vector is the empty condition. Where `real` says that a slot is PAD, logits are zero.
        """
        condition = torch.zeros_like(ids, dtype=torch.bool) if condition is None else condition
        x = self.encoder.embed(self.token_embedding(ids), self.encoder.text_projection(text)[:, None])
        return self.encoder(x, condition_mask(condition), real=real)

    def loss(
        self,
        latents: Latents,
        text: TextFeatures,
        *,
        generator: torch.Generator | None = None,
        shard: tuple[int, int] = (0, 1),
        draws: BammDraws | None = None,
    ) -> Losses:
        """Return the cross-entropy of each sample's codes and END, averaged per sample, then over samples.

        Draws come from `generator` (None: torch's own) for the global batch, of which this is the part `shard` =
        (rank, world): conditions always, random codes and dropped texts in training only. `draws` replaces them all
        (tests).
        """
        codes = self.codes(latents)
        wanted = targets(codes, latents.lengths, self.end, self.pad)
        draws = draws or self._draw(wanted, generator, shard)
        ids = torch.where(draws.corrupted & (wanted < self.codebook_size), draws.codes, wanted)
        pooled = text.pooled.masked_fill(draws.condition_drop[:, None], 0.0)
        real = wanted != self.pad
        logits = self(ids, pooled, draws.condition & real, real)[:, :-1]
        entropy = F.cross_entropy(logits.mT, wanted.masked_fill(wanted == self.pad, 0), reduction="none")
        hits = (logits.argmax(-1) == wanted).float()
        loss, accuracy = (mean_over_ranks(per_sample(v, latents.lengths), shard[1]) for v in (entropy, hits))
        return {"loss": loss, "accuracy": accuracy}

    def sample(
        self,
        text: TextFeatures,
        frames: Int[Tensor, " b"] | None,
        *,
        seeds: Int[Tensor, " b"],
        known: Known | None = None,
        sampling: BammSampling | None = None,
        draws: TokenDraws | None = None,
    ) -> Latents:
        """Generate codes for `frames` frames, exactly so many (END is excluded); None: until END, at most max_latents.

        A motion that would end before it begins is a single token, code 0 in the first iteration (as published). With
        `known` the free codes are generated once, those kept (and END behind their length) being conditions; `frames`
        None takes its lengths. A sample depends on its own seed only. `draws` replaces what the seeds draw (tests).
        """
        sampling = sampling or self.sampling
        request = self.request(text, frames, seeds, known)
        codes, lengths = request.codes[..., 0], request.lengths
        with inference(self):
            decoder = SlotDecoder(self, text.pooled.to(lengths.device), draws or sampling.draws(seeds), sampling)
            if known is None:
                codes, lengths = decoder.generate(lengths, open_end=request.open_end)
            else:
                guidance = 0.0 if sampling.official_inference else sampling.second_guidance
                codes, _ = decoder.between(codes, request.keep, lengths, guidance)
        base = self.latents(codes, lengths)
        return self.completed(base, text, seeds=seeds, known=known, sampling=sampling)

    def residual_sampling(self, sampling: BammSampling) -> ResidualSampling:
        """Return the `residual_*` options."""
        return ResidualSampling(
            sampling.residual_guidance,
            sampling.residual_temperature,
            sampling.residual_top_k,
            sampling.residual_padding,
        )

    def _draw(self, slots: Int[Tensor, "b s"], generator: torch.Generator | None, shard: tuple[int, int]) -> BammDraws:
        return share_of(
            lambda samples: BammDraws.draw(
                (samples, self.max_latents + 1),
                codebook_size=self.codebook_size,
                condition_drop=self.condition_drop if self.training else 0.0,
                corrupt=self.training,
                generator=generator,
                device=slots.device,
            ),
            len(slots),
            shard,
            slots.shape[1],
        )

"""Generate tokens as MoMask does: a masked transformer that keeps its surest guesses first (MoMask §2, §4)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from kinema.decoding.draws import SeededDraws, TokenDraws
from kinema.decoding.token_unmasking import unmask_tokens
from kinema.generators.draws import StepDraws, share_of
from kinema.generators.texts import check_guidance
from kinema.generators.tokens.choices import likely_choice
from kinema.generators.tokens.encoder import EMBEDDING_STD, TokenEncoder, guided_logits
from kinema.generators.tokens.generator import TokenGenerator
from kinema.generators.tokens.residual import ResidualSampling
from kinema.masking import cosine_counts, cosine_ratio, masked_count
from kinema.nn.mode import inference
from kinema.nn.ranks import mean_over_ranks
from kinema.options import Classes, Depth, NonNegative, OpenShare, Options, Share, Size, Steps, checked
from kinema.registry import buildable
from kinema.types import Known, Latents, Losses, TextFeatures

RANDOM_SHARE = 0.1
MASK_SHARE = 0.88


@buildable
@dataclass(frozen=True)
class MoMaskSampling(Options):
    """Choose how tokens are sampled, and by `residual_*` how a residual transformer completes them.

    `top_k` is the share of the least likely classes that no draw takes (published: 0.9); temperature 0 takes the
    likeliest class. Published guidance is 4 on HumanML3D, 2 on KIT-ML. `residual_padding` lets PAD be drawn in the
    residual layers, as published: such a layer adds nothing.
    """

    steps: Steps = 10
    guidance: NonNegative = 4.0
    temperature: NonNegative = 1.0
    top_k: OpenShare = 0.9
    residual_guidance: NonNegative = 5.0
    residual_temperature: NonNegative = 1.0
    residual_top_k: OpenShare = 0.9
    residual_padding: bool = True


@dataclass
class MoMaskDraws(StepDraws):
    """Hold what a training step draws, over all `n` positions whether they are selected or not."""

    mask_time: Float[Tensor, " b"]
    permutation: Int[Tensor, "b n"]
    to_random: Bool[Tensor, "b n"]
    to_mask: Bool[Tensor, "b n"]
    random_codes: Int[Tensor, "b n"]
    condition_drop: Bool[Tensor, " b"]

    @classmethod
    def draw(
        cls,
        shape: tuple[int, int],
        codebook_size: int,
        *,
        condition_drop: float,
        generator: torch.Generator | None,
        device: torch.device,
    ) -> MoMaskDraws:
        """Draw for `shape` = (samples, positions)."""

        def uniform(*size: int) -> Tensor:
            return torch.rand(size, generator=generator, device=device)

        return cls(
            mask_time=uniform(shape[0]),
            permutation=uniform(*shape).argsort(dim=1),
            to_random=uniform(*shape) < RANDOM_SHARE,
            to_mask=uniform(*shape) < MASK_SHARE,
            random_codes=torch.randint(codebook_size, shape, generator=generator, device=device),
            condition_drop=uniform(shape[0]) < condition_drop,
        )


@buildable
class MoMask(TokenGenerator):
    """Masked transformer over one code per position, conditioned on the pooled text (MoMask §2).

    The ids after the codes are MASK and PAD; the latter is never attended to. Lengths are frames // `downsample`, at
    most `max_latents`, and the training mask counts positions of `max_latents`, padding included, as published.
    """

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
        max_latents: Size = 49,
        downsample: Size = 4,
        sampling: MoMaskSampling | None = None,
    ) -> None:
        super().__init__(codebook_size=codebook_size, max_latents=max_latents, downsample=downsample)
        self.text_dim = text_dim
        self.mask_id, self.pad_id = codebook_size, codebook_size + 1
        self.condition_drop = condition_drop
        self.sampling = sampling or MoMaskSampling()
        self.token_embedding = nn.Embedding(codebook_size + 2, code_dim)
        self.encoder = TokenEncoder(
            code_dim=code_dim,
            text_dim=text_dim,
            outputs=codebook_size,
            width=width,
            feedforward=feedforward,
            layers=layers,
            heads=heads,
            dropout=dropout,
        )
        nn.init.normal_(self.token_embedding.weight, std=EMBEDDING_STD)
        self.check_sampling(self.sampling)

    def check_sampling(self, sampling: MoMaskSampling) -> None:
        """Refuse guidance that training gave no ground."""
        super().check_sampling(sampling)
        check_guidance(self.condition_drop, guidance=sampling.guidance)

    def forward(
        self, ids: Int[Tensor, "b n"], text: Float[Tensor, "b t"], real: Bool[Tensor, "b n"]
    ) -> Float[Tensor, "b n k"]:
        """Return the logits of every position's code; a zero text vector is the empty condition."""
        prefix = self.encoder.text_projection(text)[:, None]
        return self.encoder(self.encoder.embed(self.token_embedding(ids), prefix), real=real)[:, 1:]

    def loss(
        self,
        latents: Latents,
        text: TextFeatures,
        *,
        generator: torch.Generator | None = None,
        shard: tuple[int, int] = (0, 1),
        draws: MoMaskDraws | None = None,
    ) -> Losses:
        """Return the cross entropy and the accuracy at the selected positions (MoMask §2).

        Draws are made for the global batch, from `generator` (None: torch's own), of which this batch is the part
        `shard` = (rank, world); means are over the selected positions of all ranks. `draws` replaces them (tests).
        """
        codes = self.codes(latents)
        draws = draws or self._draw(codes, generator, shard)
        real = latents.mask
        selected = select(draws, real, self.max_latents)
        ids = corrupt(codes, selected, self.mask_id, draws).masked_fill(~real, self.pad_id)
        logits = self(ids, text.pooled.masked_fill(draws.condition_drop[:, None], 0.0), real)[selected]
        rows = nn.functional.cross_entropy(logits.float(), codes[selected], reduction="none")
        right = (logits.argmax(-1) == codes[selected]).float()
        return {"loss": mean_over_ranks(rows, shard[1]), "accuracy": mean_over_ranks(right, shard[1])}

    def sample(
        self,
        text: TextFeatures,
        frames: Int[Tensor, " b"] | None,
        *,
        seeds: Int[Tensor, " b"],
        known: Known | None = None,
        sampling: MoMaskSampling | None = None,
        draws: TokenDraws | None = None,
    ) -> Latents:
        """Generate codes for `frames` frames, or edit: regenerate the positions that `known.mask` leaves free.

        A sample depends on its own seed only. `frames` None takes the lengths of `known`. Kept codes come back equal,
        padding is 0. `draws` replaces what the seeds draw (tests).
        """
        sampling = sampling or self.sampling
        request = self.request(text, frames, seeds, known)
        pooled, real, free = text.pooled.to(request.keep.device), request.real, request.real & ~request.keep

        def predict(codes: Tensor, masked: Tensor, step: int) -> Float[Tensor, "b n k"]:
            ids = codes.masked_fill(masked, self.mask_id).masked_fill(~real, self.pad_id)
            return guided_logits(self, ids, pooled, real, scale=sampling.guidance).float()

        choose = likely_choice(draws or SeededDraws(seeds), sampling.temperature, sampling.top_k)
        counts = cosine_counts(free.sum(dim=1), sampling.steps)
        with inference(self):
            *_, (_, codes) = unmask_tokens(request.codes[..., 0], free, counts, predict, choose)
        base = self.latents(codes, request.lengths)
        return self.completed(base, text, seeds=seeds, known=known, sampling=sampling)

    def residual_sampling(self, sampling: MoMaskSampling) -> ResidualSampling:
        """Return the `residual_*` options."""
        return ResidualSampling(
            sampling.residual_guidance,
            sampling.residual_temperature,
            sampling.residual_top_k,
            sampling.residual_padding,
        )

    def _draw(
        self, codes: Int[Tensor, "b n"], generator: torch.Generator | None, shard: tuple[int, int]
    ) -> MoMaskDraws:
        drop = self.condition_drop if self.training else 0.0
        return share_of(
            lambda samples: MoMaskDraws.draw(
                (samples, self.max_latents),
                self.codebook_size,
                condition_drop=drop,
                generator=generator,
                device=codes.device,
            ),
            len(codes),
            shard,
            codes.shape[1],
        )


def select(draws: MoMaskDraws, real: Bool[Tensor, "b n"], counted: int) -> Bool[Tensor, "b n"]:
    """Select n = max(1, round(counted * cos(pi u / 2))) of the permuted positions, and of these the real ones."""
    count = masked_count(torch.tensor(counted, device=real.device), cosine_ratio(draws.mask_time))
    return (draws.permutation < count[:, None]) & real


def corrupt(
    codes: Int[Tensor, "b n"], selected: Bool[Tensor, "b n"], mask_id: int, draws: MoMaskDraws
) -> Int[Tensor, "b n"]:
    """Replace selected codes: 10 % by random ones, 88 % of the others by MASK; the rest stay (MoMask §2)."""
    random = selected & draws.to_random
    hidden = selected & ~draws.to_random & draws.to_mask
    return torch.where(random, draws.random_codes, codes).masked_fill(hidden, mask_id)

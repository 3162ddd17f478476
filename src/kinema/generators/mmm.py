"""Generate codes by masked modelling (MMM): predict all masked tokens at once, keep the confident ones, repeat."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from kinema.decoding.draws import SeededDraws, TokenDraws
from kinema.decoding.token_unmasking import choice, unmask_tokens
from kinema.generators.draws import StepDraws, share_of
from kinema.generators.tokens.reader import CodebookReader
from kinema.generators.tokens.transformer import TokenTransformer, code_losses, with_end
from kinema.generators.tokens.words import WORDS
from kinema.masking import lowest, masked_count, shrinking_counts
from kinema.nn.mode import inference
from kinema.options import (
    Classes,
    KeptShare,
    NonNegative,
    OneOf,
    OpenShare,
    OptionalDepth,
    Options,
    Size,
    Steps,
    checked,
)
from kinema.registry import buildable
from kinema.types import Known, Latents, Losses, TextFeatures

MASK_RATIOS = (0.5, 1.0)
SPECIALS = 3  # END, PAD, MASK


@buildable
@dataclass(frozen=True)
class MmmSampling(Options):
    """Choose how tokens are sampled: `steps` of unmasking at full length, `temperature` 0 for the likeliest codes."""

    steps: Steps = 10
    temperature: NonNegative = 1.0


@dataclass
class MmmDraws(StepDraws):
    """Hold what a training step draws, over all `n` positions whether they are real or not."""

    keep: Bool[Tensor, "b n"]
    replacement: Int[Tensor, "b n"]
    ratio: Float[Tensor, " b"]
    order: Float[Tensor, "b n"]

    @classmethod
    def draw(
        cls,
        shape: tuple[int, int],
        codebook_size: int,
        *,
        pkeep: float,
        generator: torch.Generator | None,
        device: torch.device,
    ) -> MmmDraws:
        """Draw for `shape` = (samples, positions); pkeep -1 draws one probability for the batch."""

        def uniform(*size: int) -> Tensor:
            return torch.rand(size, generator=generator, device=device)

        low, high = MASK_RATIOS
        return cls(
            keep=uniform(*shape) < (uniform(1) if pkeep == -1 else pkeep),
            replacement=torch.randint(codebook_size, shape, generator=generator, device=device),
            ratio=low + (high - low) * uniform(shape[0]),
            order=uniform(*shape),
        )


@buildable
class MMM(CodebookReader):
    """Masked transformer over the codes of a tokenizer whose codebook it reads (MMM).

    In training a code is kept with probability `pkeep`, else replaced by a random one (-1: one probability per batch);
    then a share U(0.5, 1) of the positions is masked. Lengths are frames // `downsample`, at most `max_latents`.
    """

    @checked
    def __init__(
        self,
        *,
        codebook_size: Classes,
        code_dim: Size,
        text_dim: Size,
        token_dim: Size,
        width: Size = 1024,
        heads: Size = 16,
        feedforward: Size = 4096,
        cross_layers: OptionalDepth = 2,
        base_layers: OptionalDepth = 7,
        head_layers: OptionalDepth = 9,
        dropout: OpenShare = 0.1,
        words: Annotated[str, OneOf(WORDS)] = "real",
        pkeep: KeptShare = 0.5,
        max_latents: Size = 49,
        downsample: Size = 4,
        sampling: MmmSampling | None = None,
    ) -> None:
        super().__init__(codebook_size=codebook_size, code_dim=code_dim, max_latents=max_latents, downsample=downsample)
        self.text_dim, self.token_dim = text_dim, token_dim if cross_layers else None
        self.pkeep = pkeep
        self.sampling = sampling or MmmSampling()
        self.mask_id = codebook_size + 2
        self.transformer = TokenTransformer(
            codebook_size=codebook_size,
            code_dim=code_dim,
            specials=SPECIALS,
            text_dim=text_dim,
            token_dim=token_dim,
            width=width,
            heads=heads,
            feedforward=feedforward,
            cross_layers=cross_layers,
            base_layers=base_layers,
            head_layers=head_layers,
            dropout=dropout,
            words=words,
        )

    def forward(
        self, ids: Int[Tensor, "b n"], text: TextFeatures, lengths: Int[Tensor, " b"]
    ) -> Float[Tensor, "b m k"]:
        """Return logits at the sentence, the n positions and the END slot (m = n + 2), zero at padding."""
        ids, visible = with_end(ids, lengths, self.codebook_size)
        return self.transformer(ids, text, visible)

    def loss(
        self,
        latents: Latents,
        text: TextFeatures,
        *,
        generator: torch.Generator | None = None,
        shard: tuple[int, int] = (0, 1),
        draws: MmmDraws | None = None,
    ) -> Losses:
        """Return the cross entropy of all codes, masked or not, mean per sample, then over the batch (MMM, Training).

        Draws are made for the global batch, from `generator` (None: torch's own), of which this batch is the part
        `shard` = (rank, world); in eval mode no code is replaced. Dropout is torch's own. `draws` replaces them all
        (tests).
        """
        codes = self.codes(latents)
        draws = draws or self._draw(codes, generator, shard)
        masked = lowest(draws.order, latents.mask, masked_count(latents.lengths, draws.ratio))
        ids = torch.where(draws.keep, codes, draws.replacement).masked_fill(masked, self.mask_id)
        return code_losses(self(ids, text, latents.lengths), codes, latents.mask)

    def sample(
        self,
        text: TextFeatures,
        frames: Int[Tensor, " b"] | None,
        *,
        seeds: Int[Tensor, " b"],
        known: Known | None = None,
        sampling: MmmSampling | None = None,
        draws: TokenDraws | None = None,
    ) -> Latents:
        """Generate codes for `frames` frames, or edit: regenerate the positions that `known.mask` leaves free.

        A sample depends on its own seed only. `frames` None takes the lengths of `known`. Kept codes come back equal,
        padding is 0. `draws` replaces what the seeds draw (tests).
        """
        sampling = sampling or self.sampling
        device, request = self.codebook.device, self.request(text, frames, seeds, known)
        text, codes, free = text.to(device), request.codes[..., 0], request.real & ~request.keep
        counts = shrinking_counts(request.lengths.cpu(), sampling.steps, free.sum(dim=1).cpu())

        def predict(codes: Tensor, masked: Tensor, step: int) -> Float[Tensor, "b n k"]:
            return self(codes.masked_fill(masked, self.mask_id), text, request.lengths)[:, 1:-1]

        choose = choice(draws or SeededDraws(seeds), sampling.temperature)
        with inference(self):
            *_, (_, codes) = unmask_tokens(codes, free, counts.to(device), predict, choose)
        base = self.latents(codes, request.lengths)
        return self.completed(base, text, seeds=seeds, known=known, sampling=sampling)

    def _draw(self, codes: Int[Tensor, "b n"], generator: torch.Generator | None, shard: tuple[int, int]) -> MmmDraws:
        pkeep = self.pkeep if self.training else 1.0

        def draw(samples: int) -> MmmDraws:
            shape = (samples, self.max_latents)
            return MmmDraws.draw(shape, self.codebook_size, pkeep=pkeep, generator=generator, device=codes.device)

        return share_of(draw, len(codes), shard, codes.shape[1])

"""Corrupt what a causal transformer reads in training, every draw in one injectable value."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional as F

from kinema.types import frame_mask


@dataclass
class GptDraws:
    """Hold what a training step draws: which input tokens are kept, and the codes that replace the others."""

    keep: Bool[Tensor, "b n"]
    codes: Int[Tensor, "b n"]

    @classmethod
    def draw(
        cls,
        shape: tuple[int, int],
        *,
        codebook_size: int,
        pkeep: float,
        generator: torch.Generator | None,
        device: torch.device,
    ) -> GptDraws:
        """Draw for `shape` = (samples, positions); `pkeep` -1 draws one rate in (0, 1) for the batch."""
        rate = torch.rand((), generator=generator, device=device) if pkeep < 0 else pkeep
        return cls(
            keep=torch.rand(shape, generator=generator, device=device) < rate,
            codes=torch.randint(codebook_size, shape, generator=generator, device=device),
        )

    def crop(self, rows: slice, positions: int) -> GptDraws:
        """Take the draws of some samples and of their first positions."""
        return GptDraws(self.keep[rows, :positions], self.codes[rows, :positions])


def targets(codes: Int[Tensor, "b n"], lengths: Int[Tensor, " b"], end: int, pad: int) -> Int[Tensor, "b m"]:
    """Return the codes, END behind the last one and PAD behind that, one position more than the codes have."""
    real = frame_mask(lengths, codes.shape[1] + 1)
    filled = F.pad(codes, (0, 1)).masked_fill(~real, pad)
    return filled.scatter(1, lengths[:, None], end)


def corrupt(ids: Int[Tensor, "b n"], draws: GptDraws) -> Int[Tensor, "b n"]:
    """Replace the ids that are not kept by random codes, END and PAD too (T2M-GPT, Training)."""
    drawn = draws.crop(slice(None), ids.shape[1])
    return torch.where(drawn.keep, ids, drawn.codes)


def per_sample(values: Float[Tensor, "b m"], lengths: Int[Tensor, " b"]) -> Float[Tensor, " b"]:
    """Average each sample's values over its codes and its END."""
    counted = frame_mask(lengths + 1, values.shape[1])
    return values.masked_fill(~counted, 0.0).sum(dim=1) / (lengths + 1)

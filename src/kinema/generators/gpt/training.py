"""Corrupt what a causal transformer reads in training, every draw in one injectable value."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from kinema.generators.draws import StepDraws


@dataclass
class GptDraws(StepDraws):
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


def corrupt(ids: Int[Tensor, "b n"], draws: GptDraws) -> Int[Tensor, "b n"]:
    """Replace the ids that are not kept by random codes, END and PAD too (T2M-GPT, Training)."""
    drawn = draws.crop(slice(None), ids.shape[1])
    return torch.where(drawn.keep, ids, drawn.codes)

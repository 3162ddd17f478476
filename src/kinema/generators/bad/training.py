"""Draw what a training step of BAD takes, in one injectable value."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from kinema.generators.draws import StepDraws


@dataclass
class BadDraws(StepDraws):
    """Hold what a training step draws, over all `n` positions whether they are real or not.

    `keep` is False where a code is replaced by `replacement`; the `ratio` of positions that are lowest in `candidates`
    is masked; `order` gives the permutation.
    """

    keep: Bool[Tensor, "b n"]
    replacement: Int[Tensor, "b n"]
    ratio: Float[Tensor, " b"]
    candidates: Float[Tensor, "b n"]
    order: Float[Tensor, "b n"]

    @classmethod
    def draw(
        cls,
        shape: tuple[int, int],
        codebook_size: int,
        *,
        max_replaced: float,
        low_mask_share: float,
        generator: torch.Generator | None,
        device: torch.device,
    ) -> BadDraws:
        """Draw for `shape` = (samples, positions) (BAD §3).

        Each sample replaces a share U(0, max_replaced) of its codes and masks a share U(0.5, 1); with probability
        `low_mask_share`, one coin for the batch, U(0, 0.5).
        """

        def uniform(*size: int) -> Tensor:
            return torch.rand(size, generator=generator, device=device)

        low = uniform(1) < low_mask_share
        return cls(
            keep=uniform(*shape) >= max_replaced * uniform(shape[0], 1),
            replacement=torch.randint(codebook_size, shape, generator=generator, device=device),
            ratio=0.5 * uniform(shape[0]) + torch.where(low, 0.0, 0.5),
            candidates=uniform(*shape),
            order=uniform(*shape),
        )

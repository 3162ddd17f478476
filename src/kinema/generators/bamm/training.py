"""Choose conditions and corrupt codes for the training of BAMM, every draw in one injectable value."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from kinema.generators.draws import StepDraws

CONDITIONED_BATCHES = 0.5
LARGEST_CONDITION_RATE = 0.5
LARGEST_CORRUPTION_RATE = 0.5


@dataclass
class BammDraws(StepDraws):
    """Hold what a training step draws, over all slots whether they are a sample's or padding."""

    condition: Bool[Tensor, "b s"]
    corrupted: Bool[Tensor, "b s"]
    codes: Int[Tensor, "b s"]
    condition_drop: Bool[Tensor, " b"]

    @classmethod
    def draw(
        cls,
        shape: tuple[int, int],
        *,
        codebook_size: int,
        condition_drop: float,
        corrupt: bool,
        generator: torch.Generator | None,
        device: torch.device,
    ) -> BammDraws:
        """Draw for `shape` = (samples, slots): one condition rate and one corruption rate for all of them.

        Half of the batches have conditions, at a rate in (0, 0.5); the corruption rate lies in (0, 0.5), or is 0
        without `corrupt`.
        """

        def uniform(*size: int) -> Tensor:
            return torch.rand(size, generator=generator, device=device)

        coin, condition_rate, corruption_rate = uniform(3)
        condition_rate = condition_rate * LARGEST_CONDITION_RATE * (coin < CONDITIONED_BATCHES)
        corruption_rate = corruption_rate * LARGEST_CORRUPTION_RATE * corrupt
        return cls(
            condition=uniform(*shape) < condition_rate,
            corrupted=uniform(*shape) < corruption_rate,
            codes=torch.randint(codebook_size, shape, generator=generator, device=device),
            condition_drop=uniform(shape[0]) < condition_drop,
        )

"""Hold what a training step of diffusion on frames draws."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Shaped
from torch import Tensor

from kinema.diffusion.ddpm import DDPM
from kinema.diffusion.flow import Flow
from kinema.generators.draws import StepDraws


@dataclass
class FrameDraws(StepDraws):
    """Hold the dropped conditions, one time per sample, and the noise of all `n` frames, padding or not."""

    condition_drop: Bool[Tensor, " b"]
    time: Shaped[Tensor, " b"]
    noise: Float[Tensor, "b n c"]

    @classmethod
    def draw(
        cls,
        shape: tuple[int, int, int],
        process: DDPM | Flow,
        *,
        condition_drop: float,
        generator: torch.Generator | None,
        device: torch.device,
    ) -> FrameDraws:
        """Draw for `shape` = (samples, frames, features)."""
        return cls(
            condition_drop=torch.rand(shape[0], generator=generator, device=device) < condition_drop,
            time=process.draw_times(shape[:1], generator, device),
            noise=torch.randn(shape, generator=generator, device=device),
        )

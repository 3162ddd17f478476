"""Hold the generators: text features to latents, knowing nothing of joints."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import torch
from jaxtyping import Int
from torch import Tensor

from kinema.types import Known, Latents, Losses, TextFeatures


@runtime_checkable
class Generator(Protocol):
    """What every text-to-latents model offers; its `sampling` is the frozen dataclass of its family."""

    sampling: Any

    def loss(
        self,
        latents: Latents,
        text: TextFeatures,
        *,
        generator: torch.Generator | None = None,
        shard: tuple[int, int] = (0, 1),
    ) -> Losses:
        """Return the training losses; draws come from `generator`, for the global batch of which this is `shard`."""

    def sample(
        self,
        text: TextFeatures,
        frames: Int[Tensor, " b"] | None,
        *,
        seeds: Int[Tensor, " b"],
        known: Known | None = None,
        sampling: Any | None = None,
    ) -> Latents:
        """Generate latents for `frames` frames of motion per text, one seed per sample."""

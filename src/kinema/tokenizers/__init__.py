"""Turn motion into latents and back: the MotionTokenizer protocol and, one file each, what implements it."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from kinema.motion.representation import Representation
from kinema.types import Latents, Losses, MotionBatch


@runtime_checkable
class MotionTokenizer(Protocol):
    """Map motion to latents and back (an nn.Module that owns the representation it was trained on)."""

    downsample: int
    representation: Representation

    def loss(self, motion: MotionBatch) -> Losses:
        """Give the training losses of a batch, `loss` first."""
        ...

    def encode(self, motion: MotionBatch) -> Latents:
        """Encode full-width, de-normalised features."""
        ...

    def decode(self, latents: Latents) -> MotionBatch:
        """Decode to de-normalised features of the representation's width; frames past `frames` are zero."""
        ...

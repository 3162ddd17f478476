"""Turn motion into latents and back: the MotionTokenizer protocol and, one file each, what implements it."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import torch

from kinema.motion.representation import Representation
from kinema.types import Latents, Losses, MotionBatch


@runtime_checkable
class MotionTokenizer(Protocol):
    """Map motion to latents and back (an nn.Module that owns the representation it was trained on).

    A tokenizer of codes also has `codebook_size`, `quantizers` (codes per position) and `code_dim`.
    """

    downsample: int
    representation: Representation

    def loss(
        self, motion: MotionBatch, *, generator: torch.Generator | None = None, shard: tuple[int, int] = (0, 1)
    ) -> Losses:
        """Return the training losses, `loss` first; draws come from `generator`, for the batch that `shard` is of."""
        ...

    def encode(self, motion: MotionBatch) -> Latents:
        """Encode full-width, de-normalised features."""
        ...

    def decode(self, latents: Latents) -> MotionBatch:
        """Decode to de-normalised features of the representation's width; frames past `frames` are zero."""
        ...

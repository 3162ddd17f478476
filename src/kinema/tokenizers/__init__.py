"""Turn motion into latents and back: what a tokenizer owes and, one file each, what implements it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from kinema.motion.representation import Representation
from kinema.types import Latents, LatentSpace, Losses, MotionBatch


class MotionTokenizer(nn.Module, ABC):
    """Map motion to latents and back; owns the representation that it was trained on.

    `space` says what it makes. `deterministic`: the same motion always has the same latents, so that they can be
    cached; if not, `encode` draws from its `generator`, and without one gives the likeliest. `copies`: latents are the
    motion's own numbers, which a cache would only multiply. `spec` rebuilds it.
    """

    space: LatentSpace
    representation: Representation
    deterministic: bool = True
    copies: bool = False
    spec: dict[str, Any] | None = None

    @property
    def codebook(self) -> Float[Tensor, "k d"] | None:
        """The code vectors (of the first layer); None where latents are no codes."""
        return None

    @abstractmethod
    def loss(
        self, motion: MotionBatch, *, generator: torch.Generator | None = None, shard: tuple[int, int] = (0, 1)
    ) -> Losses:
        """Return the training losses, `loss` first; draws come from `generator`, for the batch that `shard` is of."""

    @abstractmethod
    def encode(self, motion: MotionBatch, *, generator: torch.Generator | None = None) -> Latents:
        """Encode de-normalised features of the representation's width or more."""

    @abstractmethod
    def decode(self, latents: Latents) -> MotionBatch:
        """Decode to de-normalised features of the representation's width; frames past `frames` are zero."""

    def joints(self, values: Float[Tensor, "b n c"]) -> Float[Tensor, "b n j 3"]:
        """Place the joints of latents that are frames, in the skeleton's unit, so that gradients reach the values.

        Raises ValueError where a latent is no frame.
        """
        raise ValueError(f"{type(self).__name__} places no joints: its latents are {self.space.kind}, not frames")

"""Leave motion as frames, normalised: the tokenizer of methods that generate features themselves (MDM and its kin)."""

from __future__ import annotations

import torch

from kinema.motion.representation import Representation
from kinema.tokenizers import MotionTokenizer
from kinema.types import Latents, LatentSpace, Losses, MotionBatch


class Frames(MotionTokenizer):
    """Normalise and de-normalise; a latent is a frame. It has nothing to train: its stage takes the statistics."""

    def __init__(self, representation: Representation) -> None:
        super().__init__()
        self.representation = representation
        self.space = LatentSpace("frames", representation.width, representation.skeleton.max_frames - 1, unit=1)

    def loss(
        self, motion: MotionBatch, *, generator: torch.Generator | None = None, shard: tuple[int, int] = (0, 1)
    ) -> Losses:
        """Raise ValueError: there is nothing to train."""
        raise ValueError("frames have no tokenizer to train; set tokenizer.train=null")

    def encode(self, motion: MotionBatch, *, generator: torch.Generator | None = None) -> Latents:
        """Normalise features of the representation's width or more."""
        values = self.representation.normalize(motion.features, motion.lengths)
        return Latents(lengths=motion.lengths, frames=motion.lengths, values=values)

    def decode(self, latents: Latents) -> MotionBatch:
        """De-normalise; frames past the lengths are zero."""
        if latents.values is None:
            raise ValueError("frames are continuous values, not codes; use the tokenizer that made them")
        frames = torch.minimum(latents.frames, latents.lengths)
        return MotionBatch(self.representation.denormalize(latents.values, frames), frames)

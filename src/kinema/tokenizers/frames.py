"""Leave motion as frames, normalised, one by one (MDM and its kin) or in groups: tokenizers with nothing to learn."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from kinema.motion.recovery import recover_joints
from kinema.motion.representation import Representation
from kinema.options import Size, checked
from kinema.registry import buildable
from kinema.tokenizers import MotionTokenizer
from kinema.tokenizers.autoencoder import require_frames
from kinema.types import Latents, LatentSpace, Losses, MotionBatch


@buildable
class Frames(MotionTokenizer):
    """Normalise and de-normalise; a latent is a frame. It has nothing to train: its stage takes the statistics."""

    copies = True

    @checked
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

    def joints(self, values: Float[Tensor, "b n c"]) -> Float[Tensor, "b n j 3"]:
        """Recover the joints of normalised frames."""
        return recover_joints(self.representation.denormalize(values), self.representation.skeleton)


@buildable
class FrameGroups(MotionTokenizer):
    """Normalise, and lay `unit` frames side by side as one latent of `latent_dim` = unit * width channels.

    What MARDM diffuses without its representation reform (Table 6): latents in time, but the raw features.
    """

    copies = True

    @checked
    def __init__(self, representation: Representation, *, unit: Size, latent_dim: Size) -> None:
        super().__init__()
        if latent_dim != unit * representation.width:
            raise ValueError(
                f"latent_dim={latent_dim} is not unit x width = {unit} x {representation.width} = "
                f"{unit * representation.width}"
            )
        self.representation, self.unit = representation, unit
        most = (representation.skeleton.max_frames - 1) // unit
        self.space = LatentSpace("continuous", latent_dim, most, unit)

    def loss(
        self, motion: MotionBatch, *, generator: torch.Generator | None = None, shard: tuple[int, int] = (0, 1)
    ) -> Losses:
        """Raise ValueError: there is nothing to train."""
        raise ValueError("groups of frames have no tokenizer to train; set tokenizer.train=null")

    def encode(self, motion: MotionBatch, *, generator: torch.Generator | None = None) -> Latents:
        """Normalise and group; a tail of fewer frames than a group is dropped."""
        require_frames(motion, self.space)
        lengths, frames = self.space.latents_of(motion.lengths), self.space.covered(motion.lengths)
        values = self.representation.normalize(motion.features, frames)
        values = values[:, : self.space.covered(values.shape[1])].unflatten(1, (-1, self.unit)).flatten(2)
        return Latents(lengths=lengths, frames=frames, values=values)

    def decode(self, latents: Latents) -> MotionBatch:
        """Lay the frames of every group behind each other and de-normalise; frames past the lengths are zero."""
        if latents.values is None:
            raise ValueError("groups of frames are continuous values, not codes; use the tokenizer that made them")
        frames = torch.minimum(latents.frames, self.space.frames_of(latents.lengths))
        values = latents.values.unflatten(2, (self.unit, -1)).flatten(1, 2)
        return MotionBatch(self.representation.denormalize(values, frames), frames)

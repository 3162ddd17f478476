"""Leave motion as the absolute positions of its joints, frame by frame, normalised: the XYZ space (FRONTIER §2.1)."""

from __future__ import annotations

from typing import Annotated

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from kinema.motion.representation import Representation
from kinema.options import OneOf, checked
from kinema.registry import buildable
from kinema.tokenizers.placed import STATISTICS, PlacedTokenizer
from kinema.types import Latents, LatentSpace, Losses, MotionBatch


@buildable
class Joints(PlacedTokenizer):
    """Normalise joints; a latent is a frame of three numbers a joint, the root first. It has nothing to train.

    `statistics` as in `PlacedTokenizer`.
    """

    copies = True
    holds_joints = True

    @checked
    def __init__(
        self, representation: Representation, *, statistics: Annotated[str, OneOf(STATISTICS)] = "shared_axis"
    ) -> None:
        super().__init__(representation, statistics)
        skeleton = representation.skeleton
        self.space = LatentSpace("frames", 3 * skeleton.num_joints, skeleton.max_frames - 1, unit=1)

    @property
    def groups(self) -> dict[str, slice]:
        """The root's place and the other joints'."""
        return {"root": slice(0, 3), "joints": slice(3, self.space.width)}

    def loss(
        self, motion: MotionBatch, *, generator: torch.Generator | None = None, shard: tuple[int, int] = (0, 1)
    ) -> Losses:
        """Raise ValueError: there is nothing to train."""
        raise ValueError("frames of joints have no tokenizer to train; set tokenizer.train=null")

    def encode_joints(self, values: Float[Tensor, "b t j 3"], lengths: Int[Tensor, " b"]) -> Latents:
        """Lay the joints of a frame side by side."""
        return Latents(lengths=lengths, frames=lengths, values=values.flatten(2))

    def decode(self, latents: Latents) -> MotionBatch:
        """De-normalise and describe by essential rows; frames past the lengths are zero and are not read."""
        if latents.values is None:
            raise ValueError("frames are continuous values, not codes; use the tokenizer that made them")
        return self.describe(latents.values.unflatten(2, (-1, 3)), torch.minimum(latents.frames, latents.lengths))

    def joints(self, values: Float[Tensor, "b n c"]) -> Float[Tensor, "b n j 3"]:
        """De-normalise frames."""
        return values.unflatten(2, (-1, 3)) * self.std + self._fitted(self.mean)

    def joint_numbers(self, keep: Bool[Tensor, "b t j"]) -> Bool[Tensor, "b t c"]:
        """Say which numbers are these joints': three each."""
        return keep.repeat_interleave(3, dim=-1)

    def known_numbers(self, keep: Bool[Tensor, "b t d"]) -> Bool[Tensor, "b t c"]:
        """Say which joints stand where they stood: those all of whose columns are kept.

        The root's place on the floor is its turns and steps; a heading alone has no joint.
        """
        groups = self.representation.groups
        way = keep[..., : groups["root_linear"].stop].all(-1, keepdim=True)
        root = torch.cat((way, keep[..., groups["root_height"]], way), dim=-1)
        joints = keep[..., groups["joints"]].unflatten(-1, (-1, 3)).all(-1).repeat_interleave(3, dim=-1)
        return torch.cat((root, joints), dim=-1)

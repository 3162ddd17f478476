"""Penalise what a predicted clean motion does that bodies don't: steps, bones and standing feet (FRONTIER §9.6)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from kinema.motion.physics import FOOT_HEIGHT, SLIDING_SPEED
from kinema.motion.skeleton import Skeleton
from kinema.options import NonNegative, Options
from kinema.registry import buildable

SCALE = 0.01
"""Metres that an error is counted in."""


@buildable
@dataclass(frozen=True)
class Physics(Options):
    """Weigh the penalties: errors of joints' steps, of bones' lengths, and steps of feet that stand in the data."""

    steps: NonNegative = 0.0
    bones: NonNegative = 0.0
    feet: NonNegative = 0.0

    @property
    def used(self) -> bool:
        """Whether there is any."""
        return bool(self.steps or self.bones or self.feet)

    def penalties(
        self,
        predicted: Float[Tensor, "b n j 3"],
        joints: Float[Tensor, "b n j 3"],
        real: Bool[Tensor, "b n"],
        skeleton: Skeleton,
    ) -> Float[Tensor, "b n"]:
        """Return the weighted mean squared errors of each frame, in centimetres; joints are in the skeleton's unit."""
        scale = skeleton.meters / SCALE
        pair = real[:, 1:] & real[:, :-1]
        steps, given = predicted.diff(dim=1), joints.diff(dim=1)
        children = list(range(1, skeleton.num_joints))
        parents = [skeleton.parents[child] for child in children]
        bones, lengths = ((x[:, :, children] - x[:, :, parents]).norm(dim=-1) for x in (predicted, joints))
        toes = [skeleton.feet_left[1], skeleton.feet_right[1]]
        low = joints[:, :, toes, 1] * skeleton.meters < FOOT_HEIGHT
        slow = given[:, :, toes][..., [0, 2]].norm(dim=-1) * skeleton.meters * skeleton.fps < SLIDING_SPEED
        standing = low[:, 1:] & low[:, :-1] & slow
        slid = (steps[:, :, toes][..., [0, 2]] * scale).square().sum(dim=-1) * standing
        moved = self.steps * ((steps - given) * scale).square().mean(dim=(2, 3)) + self.feet * slid.mean(dim=2)
        stretched = self.bones * ((bones - lengths) * scale).square().mean(dim=2)
        return F.pad(torch.where(pair, moved, 0.0), (0, 1)) + torch.where(real, stretched, 0.0)

"""Say where a motion stands and which way it faces, which its feature rows don't tell (HUMANML3D_DATA §3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from kinema.motion.features import facing_yaw
from kinema.motion.rotation import rotate_yaw
from kinema.motion.skeleton import Skeleton

SLACK = 1e-4
"""Metres and radians that rounding accounts for: a motion that is so near its place is left as it is."""


@dataclass(frozen=True)
class Placement:
    """Hold a turn about +Y (radians), around the origin, and the step that follows it (in the skeleton's unit)."""

    yaw: float
    step: tuple[float, float, float]

    @classmethod
    def between(
        cls, motion: Float[np.ndarray, "t j 3"], placed: Float[np.ndarray, "s j 3"], skeleton: Skeleton
    ) -> Placement:
        """Find what takes a motion to where its like is: first facing, first root, and the lowest point as the floor.

        The two may differ in bone lengths, and in frames at the end. One that is in its place already gives no move.
        """
        yaw = facing_yaw(motion, skeleton) - facing_yaw(placed, skeleton)
        turned, frames = rotate_yaw(motion[:1], yaw), min(len(motion), len(placed))
        step = placed[0, 0] - turned[0, 0]
        step[1] = placed[:frames, :, 1].min() - motion[:frames, :, 1].min()
        slack = SLACK * max(1.0, float(np.abs(motion[0]).max()))
        if np.abs(step).max() < slack and abs(np.sin(yaw / 2)) < SLACK:
            return cls(0.0, (0.0, 0.0, 0.0))
        return cls(float(yaw), (float(step[0]), float(step[1]), float(step[2])))

    def apply(self, joints: Float[np.ndarray, "t j 3"]) -> Float[np.ndarray, "t j 3"]:
        """Move a motion; no move gives the array itself."""
        if not self.yaw and not any(self.step):
            return joints
        return (rotate_yaw(joints.astype(np.float64), self.yaw) + self.step).astype(joints.dtype)

    def undo(self, joints: Float[np.ndarray, "t j 3"]) -> Float[np.ndarray, "t j 3"]:
        """Move a motion back to where `apply` took it from."""
        return rotate_yaw(joints.astype(np.float64) - self.step, -self.yaw)

"""Find what is wrong with a clip before it enters a corpus."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from kinema.motion.kinematics import bone_lengths
from kinema.motion.skeleton import Skeleton

MAX_SPEED = 20.0
"""Metres per second: nothing on a body moves faster, so a joint that does has jumped."""

MIN_BONE = 1e-4
"""Metres: a shorter bone has no direction worth the name."""


@dataclass(frozen=True)
class Problem:
    """Hold one finding: its kind ("shape", "nan", "bone", "jump"), first frame, offending value and a sentence."""

    kind: str
    frame: int
    value: float
    message: str


def check_clip(joints: np.ndarray, skeleton: Skeleton, fps: float) -> list[Problem]:
    """List the problems of a clip, one per kind at its first frame; an empty list is a clean clip.

    "shape": not (at least 2, J, 3). "nan": NaN or infinite. "bone": a bone shorter than `MIN_BONE`. "jump": a joint
    faster than `MAX_SPEED`. A wrong shape or NaN hides the others.
    """
    joints = np.asarray(joints)
    if joints.ndim != 3 or joints.shape[1:] != (skeleton.num_joints, 3) or len(joints) < 2:
        wanted = f"(at least 2, {skeleton.num_joints}, 3)"
        return [Problem("shape", 0, float(len(joints)), f"shape is {joints.shape}, must be {wanted}")]
    bad = ~np.isfinite(joints).all(axis=(1, 2))
    if bad.any():
        frame = int(bad.argmax())
        return [Problem("nan", frame, float("nan"), f"NaN or infinite values in {bad.sum()} frames, first {frame}")]
    meters = joints.astype(np.float64) * skeleton.meters
    return [*_short_bones(meters, skeleton), *_jumps(meters, skeleton, fps)]


def _short_bones(meters: Float[np.ndarray, "t j 3"], skeleton: Skeleton) -> list[Problem]:
    lengths = bone_lengths(meters, skeleton)[:, 1:]
    found = np.argwhere(lengths < MIN_BONE)
    if not len(found):
        return []
    frame, bone = found[0]
    value = float(lengths[frame, bone])
    name = skeleton.joint_names[bone + 1]
    return [
        Problem("bone", int(frame), value, f"the bone that ends at {name!r} is {value:.2g} m long in frame {frame}")
    ]


def _jumps(meters: Float[np.ndarray, "t j 3"], skeleton: Skeleton, fps: float) -> list[Problem]:
    speed = np.linalg.norm(np.diff(meters, axis=0), axis=-1) * fps
    found = np.argwhere(speed > MAX_SPEED)
    if not len(found):
        return []
    frame, joint = found[0]
    value = float(speed[frame, joint])
    name = skeleton.joint_names[joint]
    return [Problem("jump", int(frame), value, f"{name!r} moves at {value:.1f} m/s after frame {frame}")]

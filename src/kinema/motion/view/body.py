"""Describe a motion's figure for drawing: who is whose parent, which side a joint is on, how tall it stands."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kinema.motion.skeleton import Skeleton, get_skeleton

if TYPE_CHECKING:
    from kinema.types import Motion

LEFT, MIDDLE, RIGHT = -1, 0, 1

THICKNESS = {
    "pelvis": 0.062,
    "spine": 0.062,
    "chest": 0.066,
    "neck": 0.03,
    "head": 0.03,
    "hip": 0.05,
    "knee": 0.034,
    "ankle": 0.025,
    "midfoot": 0.02,
    "foot": 0.017,
    "toe": 0.016,
    "collar": 0.045,
    "shoulder": 0.034,
    "elbow": 0.025,
    "wrist": 0.017,
}
"""Radii of a body at its joints, as shares of its stature."""
USUAL = 0.03
"""Of a joint that has none of these names."""


@dataclass(frozen=True)
class Body:
    """Hold what a renderer needs to know of a figure; `stature` is in metres and does not depend on the pose."""

    parents: tuple[int, ...]
    sides: tuple[int, ...]
    face_joints: tuple[int, int, int, int]
    head: int
    stature: float
    radii: tuple[float, ...]
    trunk: tuple[tuple[int, ...], tuple[int, ...]]
    bones: tuple[int, ...]
    hands: tuple[int, ...]
    toes: tuple[int, int]


def metres(motion: Motion) -> np.ndarray:
    """Return the joints (frames, joints, 3) in metres as float32; refuse another shape than the skeleton's."""
    skeleton = get_skeleton(motion.skeleton)
    joints = np.asarray(motion.joints, dtype=np.float32)
    if joints.ndim != 3 or joints.shape[1:] != (skeleton.num_joints, 3) or len(joints) == 0:
        raise ValueError(
            f"a motion of skeleton {skeleton.name!r} has joints of shape (frames >= 1, {skeleton.num_joints}, 3); "
            f"got {joints.shape}: recover the joints from the features, or name the skeleton they belong to"
        )
    return joints * np.float32(skeleton.meters)


def finite_metres(motion: Motion) -> np.ndarray:
    """Return the joints in metres; refuse a motion that cannot be drawn, naming its first bad frame."""
    joints = metres(motion)
    broken = np.flatnonzero(~np.isfinite(joints).all(axis=(1, 2)))
    if len(broken):
        raise ValueError(
            f"motion {motion.text!r} is not finite from frame {broken[0]} on and cannot be drawn: "
            "save it as .npz to look into it, and check the model that made it"
        )
    return joints


def body_of(motion: Motion) -> Body:
    """Describe the figure of a motion."""
    skeleton = get_skeleton(motion.skeleton)
    sides = joint_sides(skeleton)
    parents = tuple(int(p) for p in skeleton.parents)
    leaves = set(range(len(parents))) - set(parents)
    head = next(j for j in sorted(leaves) if sides[j] == MIDDLE)
    stature = _stature(metres(motion), skeleton, head)
    radii = tuple(THICKNESS.get(re.sub(r"^(left|right)_|\d$", "", name), USUAL) for name in skeleton.joint_names)
    trunk, inside = _trunk(skeleton, sides, head)
    bones = tuple(joint for joint in range(1, len(parents)) if joint not in inside)
    toes = (skeleton.feet_left[-1], skeleton.feet_right[-1])
    hands = tuple(joint for joint in sorted(leaves) if joint not in (head, *toes))
    return Body(parents, sides, skeleton.face_joints, head, stature, radii, trunk, bones, hands, toes)


def joint_sides(skeleton: Skeleton) -> tuple[int, ...]:
    """Tell for every joint whether it is left (-1), right (1) or in the middle (0)."""
    sides = [MIDDLE] * skeleton.num_joints
    for left, right in skeleton.mirror_pairs:
        sides[left], sides[right] = LEFT, RIGHT
    return tuple(sides)


def _trunk(
    skeleton: Skeleton, sides: tuple[int, ...], head: int
) -> tuple[tuple[tuple[int, ...], tuple[int, ...]], set[int]]:
    """Return the joints around which pelvis and chest lie, and all joints that are inside of them."""
    r_hip, l_hip, *shoulders = skeleton.face_joints
    inside = {r_hip, l_hip, *shoulders, skeleton.parents[head]}
    for joint in (*shoulders, skeleton.parents[head]):
        while joint > 0:
            joint = skeleton.parents[joint]
            inside.add(joint)
    spine = sorted(joint for joint in inside if sides[joint] == MIDDLE)
    return ((spine[0], r_hip, l_hip, spine[1]), (spine[1], *shoulders, *spine[2:])), inside


def _stature(joints: np.ndarray, skeleton: Skeleton, head: int) -> float:
    """Add up the bones from the left toe to the head in the middle frame: a height that a crouch does not change."""
    pose = np.nan_to_num(joints[len(joints) // 2].astype(np.float64))
    total = 0.0
    for joint in (skeleton.feet_left[-1], head):
        while joint > 0:
            total += float(np.linalg.norm(pose[joint] - pose[skeleton.parents[joint]]))
            joint = skeleton.parents[joint]
    return max(total, 1e-3)

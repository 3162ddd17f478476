"""Describe the T-pose that exported skeletons rest in, and the ways its limbs bend."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from kinema.motion.rotation import unit
from kinema.motion.skeleton import HUMANML3D, Skeleton

_Ways = dict[str, tuple[float, float, float]]


@dataclass(frozen=True, eq=False)
class RestPose:
    """Hold a skeleton's T-pose: the way from each parent (J, 3), facing +Z, the character's left at +X.

    `reach` are the ways of bones in the middle of what a body can do: a turn is measured through them, so that the
    way opposite, where a turn has no axis, is one that no body takes. `hinges` name bones whose child bends to one
    side, by that side.
    """

    skeleton: Skeleton
    directions: Float[np.ndarray, "j 3"]
    reach: dict[int, Float[np.ndarray, " 3"]]
    hinges: dict[int, Float[np.ndarray, " 3"]]

    @cached_property
    def children(self) -> tuple[tuple[int, ...], ...]:
        """The joints that hang on each joint."""
        parents = self.skeleton.parents
        return tuple(tuple(c for c, p in enumerate(parents) if p == j) for j in range(len(parents)))

    @cached_property
    def order(self) -> tuple[int, ...]:
        """All joints, parents before children."""
        found = [0]
        for joint in found:
            found.extend(self.children[joint])
        return tuple(found)


def _ways(skeleton: Skeleton, ways: _Ways) -> Float[np.ndarray, "j 3"]:
    """Read one way per joint by name; a right joint's is its left partner's, mirrored."""
    rows = []
    for name in skeleton.joint_names:
        mirrored = name.startswith("right_")
        way = np.array(ways[name.replace("right_", "left_")], dtype=np.float64)
        rows.append(way * [-1, 1, 1] if mirrored else way)
    return unit(np.array(rows))


def _both(skeleton: Skeleton, ways: _Ways) -> dict[int, Float[np.ndarray, " 3"]]:
    """Read ways of left bones by the name of their start, and mirror them for the right ones."""
    found = {}
    for name, way in ways.items():
        left = skeleton.joint_names.index(name)
        right = skeleton.joint_names.index(name.replace("left_", "right_"))
        found[left] = unit(np.array(way, dtype=np.float64))
        found[right] = found[left] * [-1, 1, 1]
    return found


_REACH: _Ways = {
    "left_shoulder": (0.8, -0.35, 0.5),
    "left_elbow": (0.5, 0, 0.87),
    "left_hip": (0.05, -0.9, 0.45),
    "left_knee": (0, -0.5, -0.87),
}
_HINGES: _Ways = {"left_shoulder": (0, 0, 1), "left_hip": (0, 0, -1)}
"""Bones named by their start: `left_shoulder` reaches to the elbow and bends the forearm forward."""


def _humanml3d(ways: _Ways) -> RestPose:
    return RestPose(HUMANML3D, _ways(HUMANML3D, ways), _both(HUMANML3D, _REACH), _both(HUMANML3D, _HINGES))


# Means over 300 clips of open-mocap where a body stands on straight legs, but for the arms: they are stretched out.
HUMANML3D_REST = _humanml3d(
    {
        "pelvis": (0, 0, 0),
        "left_hip": (0.94, -0.33, 0),
        "spine1": (0, 1, 0),
        "left_knee": (0, -1, 0),
        "spine2": (0, 1, 0),
        "left_ankle": (0, -1, 0),
        "spine3": (0, 1, 0),
        "left_foot": (0, -0.57, 0.82),
        "neck": (0, 1, 0),
        "left_collar": (0.38, 0.92, 0),
        "head": (0, 1, 0),
        "left_shoulder": (1, 0, 0),
        "left_elbow": (1, 0, 0),
        "left_wrist": (1, 0, 0),
    }
)
# The ways of the mean SMPL body, both sides' mean: poses of SMPL are turns from these.
SMPL_REST = _humanml3d(
    {
        "pelvis": (0, 0, 0),
        "left_hip": (0.60, -0.80, -0.05),
        "spine1": (0, 0.97, -0.24),
        "left_knee": (0.10, -0.99, -0.02),
        "spine2": (0, 1, 0.01),
        "left_ankle": (-0.04, -0.99, -0.11),
        "spine3": (0, 0.90, 0.43),
        "left_foot": (0.19, -0.39, 0.90),
        "neck": (0, 0.98, -0.20),
        "left_collar": (0.54, 0.81, -0.24),
        "head": (0, 0.78, 0.62),
        "left_shoulder": (0.94, 0.32, -0.09),
        "left_elbow": (0.99, -0.05, -0.10),
        "left_wrist": (1, 0.03, -0.01),
    }
)


def rest_pose(skeleton: Skeleton) -> RestPose:
    """Find a skeleton's T-pose; raises ValueError where there is none."""
    return _of(skeleton, (HUMANML3D_REST,))


def smpl_rest_pose(skeleton: Skeleton) -> RestPose:
    """Find the pose in which SMPL's body rests, on a skeleton; raises ValueError where it has other joints."""
    return _of(skeleton, (SMPL_REST,))


def _of(skeleton: Skeleton, poses: tuple[RestPose, ...]) -> RestPose:
    known = {pose.skeleton.name: pose for pose in poses}
    if skeleton.name not in known:
        raise ValueError(
            f"there is no T-pose of {skeleton.name}; motion with rotations is written for {', '.join(known)}"
        )
    return known[skeleton.name]

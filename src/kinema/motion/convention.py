"""Say how foreign joints are written, and bring them to a skeleton's convention."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from jaxtyping import Shaped

from kinema.motion.resampling import resampled
from kinema.motion.shapes import as_joints
from kinema.motion.skeleton import Skeleton

SLOWEST, FASTEST = 0.1, 10_000
"""Frames a second that motion may have."""
AXES = {
    "x": ((1, -1), (0, 1), (2, 1)),
    "y": ((0, 1), (1, 1), (2, 1)),
    "z": ((0, 1), (2, 1), (1, -1)),
    "-x": ((1, 1), (0, -1), (2, 1)),
    "-y": ((0, 1), (1, -1), (2, -1)),
    "-z": ((0, 1), (2, -1), (1, 1)),
}
"""For every axis that points up: which axis becomes x, y and z, and its sign. All are turns, none a reflection."""

ORDERS = ("own", "swapped", "limbs", "limbs-right", "trunk", "trunk-right")
"""Orders of joints that have a name: the skeleton's own; left and right exchanged; joint by joint along the limbs with
the legs first (as in MuJoCo), or with the trunk first (as in most BVH files); -right: right limbs before left ones."""

ABSENT = "-"
"""In a list of joint names: one that the skeleton doesn't have."""


@dataclass(frozen=True)
class Convention:
    """Hold what is told of foreign joints. What is None is the skeleton's and checked; what is told is believed.

    `up`: the axis that points up, of `AXES`. `handed`: "left" for coordinates of a left-handed system (Unity, Unreal).
    `scale`: the skeleton's units in one of the clip's, 0.01 for centimetres. `order`: one of `ORDERS`, or the joints'
    names, separated by commas. `fps`: frames per second. `mapping`: a file that says which joint of a capture is which.
    Numbers come from users: they are checked, not typed.
    """

    up: str | None = None
    handed: str | None = None
    scale: Any = None
    order: str | None = None
    fps: Any = None
    mapping: str | None = None

    def __post_init__(self) -> None:
        for name, value, allowed in (("up", self.up, tuple(AXES)), ("handed", self.handed, ("left", "right"))):
            if value is not None and value not in allowed:
                raise ValueError(f"{name}={value!r}; choose one of {', '.join(allowed)}")
        for name, number in (("scale", self.scale), ("fps", self.fps)):
            if number is None:
                continue
            if isinstance(number, bool) or not isinstance(number, int | float) or not 0 < number < np.inf:
                raise ValueError(f"{name}={number!r}; it must be a positive number")
        if self.fps is not None and not SLOWEST <= self.fps <= FASTEST:
            raise ValueError(f"fps={self.fps!r}; motion has from {SLOWEST} to {FASTEST} frames a second")

    def of_arrays(self) -> dict[str, Any]:
        """Return what can be told of arrays of joints; raises ValueError for what only captures have."""
        if self.mapping is not None:
            raise ValueError("joints of an array have no names to map (--mapping); tell their order with --order")
        return {field.name: getattr(self, field.name) for field in fields(self) if field.name != "mapping"}

    @property
    def vouched(self) -> frozenset[str]:
        """Name the kinds of problem that what is told rules out."""
        told = {"axis": self.up, "unit": self.scale, "order": self.order, "sides": self.handed or self.order}
        return frozenset(kind for kind, value in told.items() if value is not None)

    def apply(self, array: np.ndarray, skeleton: Skeleton) -> Shaped[np.ndarray, "t j 3"]:
        """Return joints in the skeleton's order, axes, unit and rate. Raises ValueError for what has no such joints."""
        self.of_arrays()
        if not np.issubdtype(array.dtype, np.floating):
            array = array.astype(np.float32)  # an unsigned number has no negative
        joints = as_joints(array, skeleton) if self.order is None else self._ordered(array, skeleton)
        if self.up not in (None, "y"):
            joints = np.stack([joints[..., axis] * sign for axis, sign in AXES[self.up]], axis=-1)
        if self.handed == "left":
            joints = joints * np.array([-1, 1, 1], dtype=joints.dtype)
        if self.scale is not None:
            joints = joints * self.scale
        return joints if self.fps is None else resampled(joints, self.fps, skeleton.fps)

    def _ordered(self, array: np.ndarray, skeleton: Skeleton) -> Shaped[np.ndarray, "t j 3"]:
        names = self.joint_names(skeleton)
        if array.ndim == 3 and array.shape[2] == 3 and array.shape[1] == len(names):
            return array[:, [names.index(name) for name in skeleton.joint_names]]
        if self.order in ORDERS:
            return as_joints(array, skeleton)[:, [names.index(name) for name in skeleton.joint_names]]
        raise ValueError(
            f"joints have shape {array.shape}, order names {len(names)}; name every joint, {ABSENT} for others"
        )

    def joint_names(self, skeleton: Skeleton) -> list[str]:
        """Name the clip's joints in their order. Raises ValueError for an order that lacks one of the skeleton's."""
        if self.order is None or self.order in ORDERS:
            return named_order(self.order or "own", skeleton)
        names = [name.strip() for name in self.order.split(",")]
        lacking = [name for name in skeleton.joint_names if names.count(name) != 1]
        odd = [name for name in names if name not in (*skeleton.joint_names, ABSENT)]
        if lacking or odd:
            what = f"it lacks {', '.join(lacking)}" if lacking else f"{', '.join(odd)} is none of its joints"
            raise ValueError(
                f"order={self.order!r} is not {skeleton.name}'s: {what}; choose one of {', '.join(ORDERS)}, or name "
                f"every joint once ({','.join(skeleton.joint_names)}), {ABSENT} for those that it doesn't have"
            )
        return names


AS_IS = Convention()
"""Nothing is told: joints are as the skeleton has them."""


def named_order(order: str, skeleton: Skeleton) -> list[str]:
    """Name a skeleton's joints in one of the `ORDERS`."""
    own = list(skeleton.joint_names)
    if order == "own":
        return own
    if order == "swapped":
        pairs = {own[a]: own[b] for a, b in skeleton.mirror_pairs}
        other = pairs | {right: left for left, right in pairs.items()}
        return [other.get(name, name) for name in own]
    right_leg, left_leg, trunk, right_arm, left_arm = ([own[j] for j in chain[1:]] for chain in skeleton.chains)
    legs, arms = [left_leg, right_leg], [left_arm, right_arm]
    if order.endswith("-right"):
        legs, arms = legs[::-1], arms[::-1]
    parts = [*legs, trunk, *arms] if order.startswith("limbs") else [trunk, *arms, *legs]
    return [own[0], *(name for part in parts for name in part)]

"""Find from the data itself how long a unit is and which axis is up."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float

from kinema.motion.kinematics import bone_lengths
from kinema.motion.skeleton import Skeleton

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "Acclaim": 0.0254 / 0.45}
HEIGHTS = (1.0, 2.3)
"""Metres: bodies outside are taken for another unit."""
USUAL_HEIGHT = 1.7
AXES = ("x", "y", "z", "-x", "-y", "-z")
CLEAR = 0.7
"""Cosine from which the way from the pelvis to the head tells an axis."""


def body_height(joints: Float[np.ndarray, "t j 3"], skeleton: Skeleton) -> float:
    """Measure a body in any pose, in the joints' unit: a leg, the spine, and what is above and below the joints.

    Sole to ankle and head joint to crown are taken as a ninth of the rest.
    """
    bones = np.median(bone_lengths(joints, skeleton), axis=0)
    legs = max(bones[list(chain[1:4])].sum() for chain in skeleton.chains if chain[-1] in _toes(skeleton))
    spine = next(chain for chain in skeleton.chains if chain[0] == 0 and chain[-1] not in _toes(skeleton))
    return float((legs + bones[list(spine[1:])].sum()) * 10 / 9)


def _toes(skeleton: Skeleton) -> tuple[int, int]:
    return skeleton.feet_left[1], skeleton.feet_right[1]


def find_scale(joints: Float[np.ndarray, "t j 3"], skeleton: Skeleton, source: Path) -> float:
    """Find the skeleton's units per unit of the file; raises ValueError for no human size in any of `UNITS`."""
    height = body_height(joints, skeleton)
    unit = min(UNITS, key=lambda name: abs(np.log(max(height, 1e-12) * UNITS[name] / USUAL_HEIGHT)))
    if not HEIGHTS[0] <= height * UNITS[unit] <= HEIGHTS[1]:
        raise ValueError(
            f"{source}: the body is {height:.4g} units tall, which is no human in {', '.join(UNITS)}; give the "
            "metres per unit with scale="
        )
    return UNITS[unit] / skeleton.meters


def find_up(
    joints: Float[np.ndarray, "t j 3"], rest: Float[np.ndarray, "j 3"], skeleton: Skeleton, source: Path
) -> str:
    """Find the upward axis from where the head is above the pelvis: in the rest pose, or in most frames.

    Raises ValueError if neither tells.
    """
    head = skeleton.joint_names.index("head")
    ways = np.concatenate([(joints[:, head] - joints[:, 0]), (rest[head] - rest[0])[None]])
    length = np.linalg.norm(ways, axis=-1, keepdims=True)
    ways = ways / np.where(length > 0, length, 1)
    for way in (np.median(ways[:-1], axis=0), ways[-1]):
        axis = int(np.argmax(np.abs(way)))
        if abs(way[axis]) >= CLEAR:
            return ("" if way[axis] > 0 else "-") + "xyz"[axis]
    raise ValueError(f"{source}: no axis is clearly up, the body never stands; give it with up=y, up=z, ...")


def upright(positions: Float[np.ndarray, "t j 3"], up: str) -> Float[np.ndarray, "t j 3"]:
    """Turn positions so that `up` becomes +Y: a rotation, so that left stays left."""
    if up not in AXES:
        raise ValueError(f"up={up!r} must be one of {', '.join(AXES)}")
    x, y, z = np.moveaxis(positions, -1, 0)
    turned = {
        "x": (-y, x, z),
        "y": (x, y, z),
        "z": (x, z, -y),
        "-x": (y, -x, z),
        "-y": (-x, -y, z),
        "-z": (x, -z, y),
    }[up]
    return np.stack(turned, axis=-1)

"""Measure on raw joints what tells whether they were read right: axis, sides, order, unit and rate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from kinema.motion.convention import AXES, ORDERS, Convention
from kinema.motion.kinematics import bone_lengths
from kinema.motion.rotation import unit
from kinema.motion.skeleton import Skeleton

UPRIGHT_SHARE = 0.95
"""Quantile of frames by which the most upright pose of a clip is judged: people lie down, but rarely throughout."""

USUAL_PACE = 0.43
"""Mean acceleration over mean speed of joints about the root, per frame, at 20 frames per second (median of open-mocap;
0.29 to 0.77 by source)."""

RATES = (12.5, 20, 24, 25, 30, 50, 60, 100, 120)
UNITS = (0.001, 0.01, 0.0254, 0.1, 0.3048, 10, 100, 1000)
"""Factors from a unit that files have to the one that is wanted: mm, cm, inch, dm, foot, and the other way round."""


@dataclass(frozen=True)
class Geometry:
    """Hold what a clip's joints tell, whatever the person does.

    `up` (3,): mean direction from the feet to the head. `upright`: its cosine with +Y in the most upright frames.
    `toes`: mean cosine between the feet and the facing that hips and shoulders give; negative where sides are swapped.
    `scatter`: standard deviation of the logarithms of bone lengths over the skeleton's (0 if it has none).
    `asymmetry`: greatest ratio between a left bone and its right one. `size`: legs over the skeleton's.
    """

    up: Float[np.ndarray, " 3"]
    upright: float
    toes: float
    scatter: float
    asymmetry: float
    size: float


def measure(joints: Float[np.ndarray, "t j 3"], skeleton: Skeleton) -> Geometry:
    """Measure a clip of finite joints whose bones all have a length, in the skeleton's unit."""
    joints = joints.astype(np.float64)
    feet = joints[:, [skeleton.feet_left[0], skeleton.feet_right[0]]].mean(axis=1)
    way = unit(joints[:, skeleton.joint_names.index("head")] - feet)
    bones = np.median(bone_lengths(joints, skeleton), axis=0)
    left, right = np.array(skeleton.mirror_pairs).T
    return Geometry(
        up=way.mean(axis=0),
        upright=float(np.quantile(way[:, 1], UPRIGHT_SHARE)),
        toes=float(_toes_along_facing(joints, skeleton).mean()),
        scatter=_scatter(bones, skeleton),
        asymmetry=float(np.exp(np.abs(np.log(bones[left] / bones[right])).max())),
        size=float(bones[list(skeleton.leg_joints)].sum() / skeleton.leg_length),
    )


def _toes_along_facing(joints: Float[np.ndarray, "t j 3"], skeleton: Skeleton) -> Float[np.ndarray, " t"]:
    """Compare feet and facing in the body's own frame, so that no axis matters."""
    right_hip, left_hip, right_shoulder, left_shoulder = (joints[:, joint] for joint in skeleton.face_joints)
    spine = joints[:, skeleton.joint_names.index("neck")] - joints[:, 0]
    facing = unit(np.cross(left_hip - right_hip + left_shoulder - right_shoulder, spine))
    feet = [joints[:, toe] - joints[:, ankle] for ankle, toe in (skeleton.feet_left, skeleton.feet_right)]
    return (facing * unit(feet[0] + feet[1])).sum(axis=-1)


def _scatter(bones: Float[np.ndarray, " j"], skeleton: Skeleton) -> float:
    if skeleton.bone_lengths is None:
        return 0.0
    return float(np.log(bones[1:] / skeleton.bone_lengths[1:]).std())


def up_axis(geometry: Geometry) -> str:
    """Name the axis along which the head is above the feet."""
    axis = int(np.abs(geometry.up).argmax())
    name = ("-" if geometry.up[axis] < 0 else "") + "xyz"[axis]
    assert name in AXES
    return name


def likely_scale(geometry: Geometry) -> float:
    """Find the factor to the skeleton's unit: that of a usual unit, or of a body of the usual size."""
    factor = min(UNITS, key=lambda f: abs(np.log(f * geometry.size)))
    return factor if 0.5 < factor * geometry.size < 2 else float(f"{1 / geometry.size:.2g}")


def likely_order(joints: Float[np.ndarray, "t j 3"], skeleton: Skeleton) -> str | None:
    """Find the named order in which the joints make a body whose toes point ahead; None if there is none."""
    best, found = np.inf, None
    for order in ORDERS:
        seen = measure(Convention(order=order).apply(joints, skeleton), skeleton)
        mark = seen.scatter + np.log(seen.asymmetry)
        if seen.toes > 0 and mark < best:
            best, found = mark, order
    return found if best < 0.7 else None


def pace(joints: Float[np.ndarray, "t j 3"]) -> float:
    """Return mean acceleration over mean speed of joints about the root, per frame; NaN where nothing moves."""
    steps = np.diff(joints - joints[:, :1], axis=0)
    speed = np.linalg.norm(steps, axis=-1).mean() if len(steps) > 1 else 0.0
    return float(np.linalg.norm(np.diff(steps, axis=0), axis=-1).mean() / speed) if speed > 0 else float("nan")


def likely_rate(pace_of_corpus: float, read_at: float) -> float | None:
    """Guess the rate at which people move like that; None where the rate that was read fits within a factor of 2.2."""
    wanted = 20 * USUAL_PACE / pace_of_corpus  # a pace is per frame: at twice the rate it is half
    if not np.isfinite(wanted) or 1 / 2.2 < wanted / read_at < 2.2:
        return None
    return min(RATES, key=lambda rate: abs(np.log(rate / wanted)))

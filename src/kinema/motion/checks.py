"""Find what is wrong with a clip before it enters a corpus: on raw joints, before bones are fitted to a skeleton."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from kinema.motion.convention import ABSENT, AS_IS, Convention
from kinema.motion.geometry import Geometry, likely_order, likely_scale, measure, up_axis
from kinema.motion.kinematics import bone_lengths
from kinema.motion.shapes import explain
from kinema.motion.skeleton import Skeleton

MAX_SPEED = 20.0
"""Metres per second: nothing on a body moves faster, so a joint that does has jumped."""

MIN_BONE = 1e-4
"""Metres: a shorter bone has no direction worth the name."""

MIN_UPRIGHT = 0.75
"""Cosine between +Y and the way from feet to head that a clip must reach (0.96 at least over open-mocap's 2,817 clips,
where 99.5 % of those written with another axis up stay below 0.7)."""

MIN_TOES = -0.1
"""Mean cosine between feet and facing (-0.01 at least over open-mocap, where 99 % have more than 0.24)."""

MAX_SCATTER, MAX_ASYMMETRY = 0.5, 1.6
"""Scatter and asymmetry of bones (0.38 and 1.15 at most over open-mocap; other orders have more than 0.53 and 1.8)."""

SIZES = (0.4, 2.5)
"""Legs over the skeleton's usual ones, from toddlers to giants (0.96 to 1.14 over open-mocap)."""


@dataclass(frozen=True)
class Problem:
    """Hold one finding: its kind, first frame, offending value, a sentence and what puts it right.

    A clip with a `fatal` one makes no features worth having.
    """

    kind: str
    frame: int
    value: float
    message: str
    fix: str
    fatal: bool = True


def check_clip(joints: np.ndarray, skeleton: Skeleton, fps: float, convention: Convention = AS_IS) -> list[Problem]:
    """List the problems of a clip's raw joints, one per kind; an empty list is a clean clip.

    "shape": not (at least 2, J, 3). "nan": NaN or infinite. "bone": a bone shorter than `MIN_BONE`. "order": joints
    in another order. "axis": Y doesn't point up. "sides": left and right swapped. "unit": no human size. "jump": a
    joint faster than `MAX_SPEED`. Each of the first four hides those behind it, a wrong unit the jumps; what
    `convention` tells is believed.
    """
    joints = np.asarray(joints)
    if joints.ndim != 3 or joints.shape[1:] != (skeleton.num_joints, 3) or len(joints) < 2:
        return [_wrong_shape(joints, skeleton)]
    bad = ~np.isfinite(joints).all(axis=(1, 2))
    if bad.any():
        frame = int(bad.argmax())
        message = f"NaN or infinite values in {bad.sum()} frames, first {frame}"
        return [Problem("nan", frame, float("nan"), message, "extract the clip again, or cut these frames out")]
    meters = joints.astype(np.float64) * skeleton.meters
    if short := _short_bones(meters, skeleton):
        return short
    found = [p for p in _misread(joints, skeleton) if p.kind not in convention.vouched]
    return found if any(p.kind in ("order", "unit") for p in found) else [*found, *_jumps(meters, skeleton, fps)]


def _wrong_shape(joints: np.ndarray, skeleton: Skeleton) -> Problem:
    if joints.ndim == 3 and joints.shape[1:] == (skeleton.num_joints, 3):
        return Problem("shape", 0, len(joints), f"{len(joints)} frames; features need at least 2", "leave the clip out")
    message = f"shape is {joints.shape}, must be (at least 2, {skeleton.num_joints}, 3)"
    return Problem("shape", 0, float(len(joints) if joints.ndim else 0), message, explain(joints.shape, skeleton))


def _short_bones(meters: Float[np.ndarray, "t j 3"], skeleton: Skeleton) -> list[Problem]:
    lengths = bone_lengths(meters, skeleton)[:, 1:]
    found = np.argwhere(lengths < MIN_BONE)
    if not len(found):
        return []
    frame, bone = found[0]
    value = float(lengths[frame, bone])
    message = f"the bone that ends at {skeleton.joint_names[bone + 1]!r} is {value:.2g} m long in frame {frame}"
    return [Problem("bone", int(frame), value, message, "repair the tracking, or cut these frames out")]


def _misread(joints: Float[np.ndarray, "t j 3"], skeleton: Skeleton) -> Iterator[Problem]:
    """Find what a wrong convention leaves in a body; in another order of joints nothing else means anything."""
    seen = measure(joints, skeleton)
    if seen.scatter > MAX_SCATTER or seen.asymmetry > MAX_ASYMMETRY:
        yield _wrong_order(seen, joints, skeleton)
        return
    if seen.upright < MIN_UPRIGHT:
        axis = up_axis(seen)
        message = f"Y isn't the upright axis: the head isn't above the feet along Y in any pose, it is along {axis}"
        yield Problem("axis", 0, seen.upright, message, f"--up {axis} (or --up y if the person really lies throughout)")
    if seen.toes < MIN_TOES:
        message = f"left and right are swapped: the toes point against the facing (cosine {seen.toes:.2f})"
        fix = (
            "--order swapped if joints are exchanged, --handed left if the coordinates are left-handed (Unity, Unreal)"
        )
        yield Problem("sides", 0, seen.toes, message, fix)
    if not SIZES[0] <= seen.size <= SIZES[1]:
        scale = likely_scale(seen)
        message = f"the unit is not {skeleton.name}'s ({skeleton.unit}): the body is {seen.size:.3g} times as large"
        yield Problem("unit", 0, seen.size, message, f"--scale {scale:g} (joints are multiplied by it)")


def _wrong_order(seen: Geometry, joints: Float[np.ndarray, "t j 3"], skeleton: Skeleton) -> Problem:
    order = likely_order(joints, skeleton)
    message = (
        f"joints are in another order than {skeleton.name}'s: a left bone and its right one differ by a factor of "
        f"{seen.asymmetry:.1f}, lengths scatter by {seen.scatter:.2f} (in its own below {MAX_ASYMMETRY}, {MAX_SCATTER})"
    )
    fix = (
        f"--order with the names of your joints in their order, {ABSENT} for others, e.g. pelvis,left_hip,right_hip,..."
    )
    return Problem("order", 0, seen.scatter, message, fix if order is None else f"--order {order}")


def _jumps(meters: Float[np.ndarray, "t j 3"], skeleton: Skeleton, fps: float) -> list[Problem]:
    speed = np.linalg.norm(np.diff(meters, axis=0), axis=-1) * fps
    found = np.argwhere(speed > MAX_SPEED)
    if not len(found):
        return []
    frame, joint = found[0]
    value = float(speed[frame, joint])
    message = f"{skeleton.joint_names[joint]!r} moves at {value:.1f} m/s after frame {frame}"
    return [Problem("jump", int(frame), value, message, "cut or repair the motion there", fatal=False)]

"""Pack motions into what the viewer plays: joints as 16-bit integers, and the figure they belong to."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kinema.motion.skeleton import get_skeleton
from kinema.motion.view.body import body_of, metres

if TYPE_CHECKING:
    from kinema.types import Motion

_INT16 = 32767


@dataclass(frozen=True)
class Packed:
    """Hold joints in metres as 16-bit integers: `value = integer * scale + centre`, per axis centre, one scale."""

    data: str
    scale: float
    centre: tuple[float, float, float]


def pack(joints: np.ndarray) -> Packed:
    """Quantise joint positions (frames, joints, 3) to int16 in base64; the error is at most half of `scale`."""
    flat = joints.reshape(-1, 3).astype(np.float64)
    low, high = flat.min(axis=0), flat.max(axis=0)
    centre = (low + high) / 2
    scale = max(float((high - low).max()) / 2 / _INT16, 1e-9)
    integers = np.rint((flat - centre) / scale).clip(-_INT16, _INT16).astype("<i2")
    x, y, z = (float(c) for c in centre)
    return Packed(base64.b64encode(integers.tobytes()).decode(), scale, (x, y, z))


def broken_from(motion: Motion) -> int | None:
    """Return the first frame that is not finite; None: the motion can be played."""
    broken = np.flatnonzero(~np.isfinite(metres(motion)).all(axis=(1, 2)))
    return int(broken[0]) if len(broken) else None


def playable(motion: Motion) -> dict[str, Any]:
    """Return a finite motion as track.js reads it, ready for JSON."""
    body, packed = body_of(motion), pack(metres(motion))
    return {
        "fps": motion.fps,
        "parents": body.parents,
        "sides": body.sides,
        "face": body.face_joints,
        "head": body.head,
        "stature": round(body.stature, 4),
        "scale": float(f"{packed.scale:.9g}"),
        "centre": [float(f"{c:.6g}") for c in packed.centre],
        "radii": body.radii,
        "bones": body.bones,
        "trunk": body.trunk,
        "hands": body.hands,
        "toes": body.toes,
        "standing": standing(motion),
        "kept": ranges(motion.kept),
        "joints": packed.data,
    }


def standing(motion: Motion) -> list[list[tuple[int, int]]]:
    """Return the ranges of frames in which the left and the right foot stand; the lowest toe of all is on the floor."""
    from kinema.motion.feet import contacts  # here: it needs torch, and most of a report does not

    skeleton, joints = get_skeleton(motion.skeleton), metres(motion)
    toes = [joints[:, foot[-1]].astype(np.float64) for foot in (skeleton.feet_left, skeleton.feet_right)]
    floor = min(float(toe[:, 1].min()) for toe in toes)
    return [ranges(contacts(toe - [0, floor, 0], motion.fps)) for toe in toes]


def ranges(mask: np.ndarray | None) -> list[tuple[int, int]]:
    """Return the runs of True in a mask over frames as (start, end); none for no mask."""
    if mask is None:
        return []
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(start), int(end)) for start, end in edges.reshape(-1, 2)]

"""Write a rig as BVH: a T-pose at rest, centimetres, Y up, Mixamo's joint names, which most tools know."""

from __future__ import annotations

import numpy as np

from kinema.motion.captures.capture import Capture
from kinema.motion.captures.mapping import known_mappings
from kinema.motion.rig.changes import Unit
from kinema.motion.rig.euler import continuous_euler

UNITS: dict[Unit, float] = {"cm": 100.0, "m": 1.0}
ORDER = "ZXY"


def bvh_text(capture: Capture, *, unit: Unit = "cm") -> str:
    """Write a rig's tree and its frames; the root's OFFSET is zero, its channels hold where it is."""
    scale = UNITS[unit]
    names = [next(iter(known_mappings()["mixamo"].joints[name])) for name in capture.names]
    order: list[int] = []
    lines = ["HIERARCHY", *_joint(capture, names, 0, 0, scale, order), "MOTION"]
    lines += [f"Frames: {capture.frames}", f"Frame Time: {1 / capture.fps:.8f}"]
    angles = continuous_euler(capture.rotations, ORDER)[:, order]
    places = capture.translations[:, 0] * scale
    numbers = np.concatenate([places, angles.reshape(capture.frames, -1)], axis=1)
    lines += [" ".join(f"{value:.6f}" for value in row) for row in numbers]
    return "\n".join(lines) + "\n"


def _joint(capture: Capture, names: list[str], joint: int, depth: int, scale: float, order: list[int]) -> list[str]:
    """Write a joint and what hangs on it; `order` collects joints as they are written."""
    order.append(joint)
    pad, children = "\t" * depth, [c for c, parent in enumerate(capture.parents) if parent == joint]
    offset = np.zeros(3) if depth == 0 else capture.rest[joint] * scale
    turns = " ".join(f"{axis}rotation" for axis in ORDER)
    channels = f"6 Xposition Yposition Zposition {turns}" if depth == 0 else f"3 {turns}"
    lines = [f"{pad}{'JOINT' if depth else 'ROOT'} {names[joint]}", f"{pad}{{", f"{pad}\t{_offset(offset)}"]
    lines.append(f"{pad}\tCHANNELS {channels}")
    for child in children:
        lines += _joint(capture, names, child, depth + 1, scale, order)
    if not children:
        # Tools draw a bone to here: as long as half the one before, the same way.
        lines += [f"{pad}\tEnd Site", f"{pad}\t{{", f"{pad}\t\t{_offset(offset / 2)}", f"{pad}\t}}"]
    return [*lines, f"{pad}}}"]


def _offset(values: np.ndarray) -> str:
    return "OFFSET " + " ".join(f"{value:.6f}" for value in values)

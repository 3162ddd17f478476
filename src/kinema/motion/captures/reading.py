"""Read a capture file of any known format and bring it to a skeleton: joints in its order, unit, axes and rate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from kinema.motion.captures.asf import read_amc
from kinema.motion.captures.bvh import read_bvh
from kinema.motion.captures.capture import Capture, usual_rate
from kinema.motion.captures.mapping import JointMapping, find_mapping
from kinema.motion.captures.orientation import body_height, find_scale, find_up
from kinema.motion.convention import Convention
from kinema.motion.skeleton import HUMANML3D, Skeleton

READERS: dict[str, Callable[[Path], Capture]] = {".bvh": read_bvh, ".amc": read_amc}
LEAP, NEXT = 3.0, 10
"""A rest pose ends in a leap: so many times the largest step of the next frames."""
REFUSED = {
    ".c3d": "C3D holds markers, no joints: solve a skeleton first (Mokka, Vicon, MotionBuilder) and export BVH",
    ".fbx": "FBX isn't read: open it in Blender and export BVH (File, Export, Motion Capture)",
    ".asf": "an ASF file holds the skeleton alone: give the .amc files beside it",
}


@dataclass(frozen=True)
class Understood:
    """Say how a capture was read: which mapping, how many units a metre, which axis up, what was left out in front.

    `notes` are what had to be decided on the way.
    """

    mapping: str
    scale: float
    guessed_scale: bool
    up: str
    fps: float
    skipped: int
    height: float
    notes: tuple[str, ...] = ()

    def __str__(self) -> str:
        """One line for people."""
        scale = f"{'guessed ' if self.guessed_scale else ''}scale {self.scale:.6g}"
        skipped = f", {self.skipped} frames of a rest pose left out" if self.skipped else ""
        said = f"{self.mapping}, {self.fps:g} fps, {self.up} up, {scale}: a body of {self.height:.2f} m{skipped}"
        return "; ".join((said, *self.notes))


def read_capture(path: str | Path) -> Capture:
    """Read a file by its suffix; raises ValueError for one that isn't read, with the way out."""
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix in REFUSED:
        raise ValueError(f"{path}: {REFUSED[suffix]}")
    if suffix not in READERS:
        raise ValueError(f"{path}: {suffix or 'a file without a suffix'} is no capture; read are {', '.join(READERS)}")
    return READERS[suffix](path)


def captured_joints(
    capture: Capture,
    source: Path,
    *,
    skeleton: Skeleton = HUMANML3D,
    mapping: JointMapping | None = None,
    scale: float | None = None,
    up: str | None = None,
    fps: float | None = None,
) -> tuple[Float[np.ndarray, "t j 3"], Understood]:
    """Map a capture to a skeleton: (T, J, 3) in its unit, Y up, at its rate.

    Args:
        mapping: which joint is which (None: recognised by the names).
        scale: the skeleton's units per unit of the file (None: the mapping's, or found from the body's height).
        up: the file's upward axis, "x", "y", "z" or "-x", ... (None: the file's, or found from the pose).
        fps: the rate of the capture, where the file is wrong (None: the file's).
    """
    mapping = mapping or find_mapping(capture.names, source)
    lacking = mapping.lacking(capture.names)
    if lacking:
        raise ValueError(f"{source} lacks {', '.join(lacking)}, which the mapping {mapping.title!r} reads")
    skipped = _skipped(capture, mapping)
    if capture.frames - skipped < 2:
        raise ValueError(f"{source} has {capture.frames} frames, {skipped} of them a rest pose; motion needs two")
    rate = fps or usual_rate(capture.fps)
    weights = mapping.weights(capture.names, skeleton)
    rest = weights @ capture.rest_positions
    kept = capture.part(skipped)
    positions = np.einsum("js,tsc->tjc", weights, replace(kept, fps=rate).at(skeleton.fps).positions)
    found = up or capture.up or find_up(positions, rest, skeleton, source)
    factor = scale or mapping.scale or find_scale(positions, skeleton, source)
    joints = Convention(up=found).apply(positions, skeleton) * factor
    height = body_height(joints, skeleton) * skeleton.meters
    guessed = scale is None and mapping.scale is None
    notes = [capture.note] if capture.note else []
    if not skipped and (resting := _resting(capture)):
        notes.append(f"the first {resting} frames are without rotations, a rest pose perhaps, and were kept")
    return joints, Understood(mapping.title, factor, guessed, found, rate, skipped, height, tuple(notes))


def _skipped(capture: Capture, mapping: JointMapping) -> int:
    """Count the frames of a rest pose in front: as the mapping says, or frames without rotations, then a leap."""
    if mapping.skip_frames:
        return mapping.skip_frames
    first = _resting(capture)
    if not first:
        return 0
    steps = np.abs(np.diff(capture.rotations[first - 1 :], axis=0)).max(axis=(1, 2, 3))
    return first if len(steps) < 2 or steps[0] > LEAP * steps[1 : 1 + NEXT].max() else 0


def _resting(capture: Capture) -> int:
    """Count the frames without rotations in front; none where all are."""
    still = np.isclose(capture.rotations, np.eye(3), atol=1e-6).all(axis=(1, 2, 3))
    return 0 if still.all() else int(np.argmin(still))

"""Save a motion in the format its file name asks for, and read back the one that holds all of it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from kinema.atomic import replacing
from kinema.motion.captures.capture import Capture
from kinema.motion.formats.arrays import load_npz, save_npy, save_npz
from kinema.motion.formats.bvh import bvh_text
from kinema.motion.formats.glb import glb_bytes, vrma_bytes
from kinema.motion.rig.changes import Changes
from kinema.motion.rig.fit import fit_rig
from kinema.motion.rig.pose import rest_pose
from kinema.motion.skeleton import Skeleton, get_skeleton
from kinema.motion.view.html import save_html
from kinema.motion.view.video import save_mp4, save_strip
from kinema.types import Motion

__all__ = ["FORMATS", "load_npz", "save"]


def save(motion: Motion, path: str | Path, changes: Changes | None = None) -> Path:
    """Save one motion by the suffix of `path` (see `FORMATS`).

    Formats of rotations (`RIGGED`) fit them to the joints and may be changed: raises ValueError for changes of another
    format, or a skeleton without a T-pose.
    """
    path = Path(path)
    if path.suffix not in FORMATS:
        known = ", ".join(FORMATS)
        raise ValueError(
            f"cannot save a motion as {path.name!r}: unknown suffix {path.suffix!r}, choose one of {known}"
        )
    if path.suffix in RIGGED:
        return _save_rigged(motion, path, changes or Changes())
    if changes not in (None, Changes()):
        raise ValueError(
            f"{path.name}: rate, place, facing, loop and axes are changed in {', '.join(RIGGED)}, which hold "
            "rotations; write one of these, or leave these options out"
        )
    return PLAIN[path.suffix](motion, path)


def _save_rigged(motion: Motion, path: Path, changes: Changes) -> Path:
    if changes.z_up and path.suffix != ".bvh":
        raise ValueError(f"{path.name}: {path.suffix} is Y up by its specification; Z up is an option of .bvh")
    skeleton = get_skeleton(motion.skeleton)
    fitted = fit_rig(np.asarray(motion.joints) * skeleton.meters, rest_pose(skeleton), motion.fps)
    content = RIGGED[path.suffix](changes.apply(fitted), skeleton, motion.text or "motion")
    with replacing(path) as temporary:
        temporary.write_bytes(content)
    return path


RIGGED: dict[str, Callable[[Capture, Skeleton, str], bytes]] = {
    ".bvh": lambda rig, skeleton, title: bvh_text(rig).encode(),
    ".glb": lambda rig, skeleton, title: glb_bytes(rig, skeleton, title=title),
    ".vrma": lambda rig, skeleton, title: vrma_bytes(rig, title=title),
}
PLAIN: dict[str, Callable[[Motion, Path], Path]] = {
    ".html": lambda motion, path: save_html([motion], path, title=motion.text or "Kinema motion"),
    ".mp4": save_mp4,
    ".png": save_strip,
    ".npy": save_npy,
    ".npz": save_npz,
}
FORMATS = (*PLAIN, *RIGGED)
"""Suffixes that a motion can be saved as."""

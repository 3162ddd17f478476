"""Save a motion in the format its file name asks for, and read back the one that holds all of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinema.atomic import replacing
from kinema.motion.captures.capture import Capture
from kinema.motion.formats.amass import amass_bytes
from kinema.motion.formats.arrays import load_npz, save_npy, save_npz
from kinema.motion.formats.bvh import bvh_text
from kinema.motion.formats.fbx import fbx_bytes
from kinema.motion.formats.glb import glb_bytes, vrma_bytes
from kinema.motion.rig.changes import Changes
from kinema.motion.rig.fit import fit_rig
from kinema.motion.rig.pose import RestPose, rest_pose, smpl_rest_pose
from kinema.motion.skeleton import Skeleton, get_skeleton
from kinema.motion.view.html import save_html
from kinema.motion.view.video import save_mp4, save_strip
from kinema.types import Motion

__all__ = ["FORMATS", "RIGGED", "format_of", "load_npz", "save"]


@dataclass(frozen=True)
class Rigged:
    """Describe a format of rotations: what writes a rig in metres, and the pose that it rests in.

    `free`: its axes and unit are the user's choice, not its specification's.
    """

    content: Callable[[Capture, Skeleton, str, Changes], bytes]
    rest: Callable[[Skeleton], RestPose] = rest_pose
    free: bool = False

    def fit(self, motion: Motion) -> Capture:
        """Fit rotations to a motion's joints, in metres."""
        skeleton = get_skeleton(motion.skeleton)
        return fit_rig(np.asarray(motion.joints) * skeleton.meters, self.rest(skeleton), motion.fps)


def format_of(path: str | Path) -> str:
    """Find the ending of a file's name that says its format, one of `FORMATS`; raises ValueError for another."""
    name = Path(path).name
    found = [ending for ending in FORMATS if name.endswith(ending)]
    if not found:
        suffix, known = Path(path).suffix, ", ".join(FORMATS)
        raise ValueError(f"cannot save a motion as {name!r}: unknown suffix {suffix!r}, choose one of {known}")
    return max(found, key=len)


def save(motion: Motion, path: str | Path, changes: Changes | None = None) -> Path:
    """Save one motion by the ending of `path` (see `FORMATS`).

    Formats of rotations (`RIGGED`) fit them to the joints and may be changed: raises ValueError for changes of another
    format, or a skeleton without a T-pose.
    """
    path = Path(path)
    kind = format_of(path)
    if kind in RIGGED:
        return _save_rigged(motion, path, RIGGED[kind], changes or Changes())
    if changes not in (None, Changes()):
        raise ValueError(
            f"{path.name}: rate, place, facing, loop, axes and unit are changed in {', '.join(RIGGED)}, which hold "
            "rotations; write one of these, or leave these options out"
        )
    return PLAIN[kind](motion, path)


def _save_rigged(motion: Motion, path: Path, kind: Rigged, changes: Changes) -> Path:
    if not kind.free and (changes.z_up or changes.unit != Changes().unit):
        free = ", ".join(name for name, other in RIGGED.items() if other.free)
        raise ValueError(
            f"{path.name}: up axis and unit of {format_of(path)} are set by its specification; Z up and --unit are "
            f"options of {free}"
        )
    skeleton = get_skeleton(motion.skeleton)
    title = (motion.text or "motion").encode(errors="replace").decode()  # half a character is no text to other tools
    content = kind.content(changes.apply(kind.fit(motion)), skeleton, title, changes)
    with replacing(path) as temporary:
        temporary.write_bytes(content)
    return path


RIGGED = {
    ".bvh": Rigged(lambda rig, skeleton, title, changes: bvh_text(rig, unit=changes.unit).encode(), free=True),
    ".glb": Rigged(lambda rig, skeleton, title, changes: glb_bytes(rig, skeleton, title=title)),
    ".vrma": Rigged(lambda rig, skeleton, title, changes: vrma_bytes(rig, title=title)),
    ".fbx": Rigged(lambda rig, skeleton, title, changes: fbx_bytes(rig, skeleton, title=title)),
    ".amass.npz": Rigged(lambda rig, skeleton, title, changes: amass_bytes(rig, title=title), smpl_rest_pose),
}
"""Formats of rotations by the ending of their files' names."""
PLAIN: dict[str, Callable[[Motion, Path], Path]] = {
    ".html": lambda motion, path: save_html([motion], path, title=motion.text or "Kinema motion"),
    ".mp4": save_mp4,
    ".png": save_strip,
    ".npy": save_npy,
    ".npz": save_npz,
}
FORMATS = (*PLAIN, *RIGGED)
"""Endings of the names that a motion can be saved under."""

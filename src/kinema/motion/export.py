"""Save a motion in the format its file name asks for, and read back the one that holds all of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from kinema.atomic import replacing
from kinema.motion.captures.capture import Capture
from kinema.motion.formats.amass import amass_bytes
from kinema.motion.formats.arrays import load_npz, save_npy, save_npz
from kinema.motion.formats.bvh import bvh_text
from kinema.motion.formats.fbx import fbx_bytes, require_blender
from kinema.motion.formats.glb import glb_bytes, vrma_bytes
from kinema.motion.rig.changes import Changes
from kinema.motion.rig.fit import fit_rig
from kinema.motion.rig.pose import RestPose, rest_pose, smpl_rest_pose
from kinema.motion.skeleton import Skeleton, get_skeleton
from kinema.motion.view.draw import require_matplotlib
from kinema.motion.view.html import save_html
from kinema.motion.view.video import require_encoder, save_mp4, save_strip
from kinema.types import Motion

__all__ = ["FORMATS", "RIGGED", "check", "format_of", "load_npz", "save"]


class Format(Protocol):
    """Describe what writes motions under an ending, and what it refuses before there is one."""

    def check(self, name: str, skeleton: Skeleton, changes: Changes) -> None:
        """Refuse a skeleton or changes that it can't write; costs nothing."""

    def require(self) -> None:
        """Raise ImportError or ValueError, with the fix, where a program that it needs isn't there."""

    def write(self, motion: Motion, path: Path, changes: Changes) -> None:
        """Write a motion."""


def _nothing() -> None:
    """Need no program."""


@dataclass(frozen=True)
class Plain:
    """Describe a format of positions or pictures, which takes no changes."""

    save: Callable[[Motion, Path], object]
    require: Callable[[], None] = _nothing

    def check(self, name: str, skeleton: Skeleton, changes: Changes) -> None:
        """Refuse changes."""
        if changes != Changes():
            raise ValueError(
                f"{name}: rate, place, facing, loop, axes and unit are changed in {', '.join(RIGGED)}, which hold "
                "rotations; write one of these, or leave these options out"
            )

    def write(self, motion: Motion, path: Path, changes: Changes) -> None:
        """Write a motion as it is."""
        self.save(motion, path)


@dataclass(frozen=True)
class Rigged:
    """Describe a format of rotations: what writes a rig in metres, and the pose that it rests in.

    `free`: its axes and unit are the user's choice, not its specification's.
    """

    content: Callable[[Capture, Skeleton, str, Changes], bytes]
    rest: Callable[[Skeleton], RestPose] = rest_pose
    free: bool = False
    require: Callable[[], None] = _nothing

    def check(self, name: str, skeleton: Skeleton, changes: Changes) -> None:
        """Refuse a skeleton without a rest pose, and axes and a unit that are not the user's to choose."""
        if not self.free and (changes.z_up or changes.unit != Changes().unit):
            free = ", ".join(ending for ending, other in RIGGED.items() if other.free)
            raise ValueError(
                f"{name}: up axis and unit of {format_of(name)} are set by its specification; Z up and --unit are "
                f"options of {free}"
            )
        try:
            self.rest(skeleton)
        except ValueError as error:
            raise ValueError(f"{name}: {error}; write one of {', '.join(PLAIN)}") from None

    def fit(self, motion: Motion) -> Capture:
        """Fit rotations to a motion's joints, in metres."""
        skeleton = get_skeleton(motion.skeleton)
        if broken := int((~np.isfinite(motion.joints)).any((1, 2)).sum()):
            raise ValueError(
                f"{broken} of {len(motion.joints)} frames hold NaN or infinity, which no rotation leads to"
            )
        return fit_rig(np.asarray(motion.joints) * skeleton.meters, self.rest(skeleton), motion.fps)

    def write(self, motion: Motion, path: Path, changes: Changes) -> None:
        """Write a motion as rotations, changed."""
        skeleton = get_skeleton(motion.skeleton)
        title = (motion.text or "motion").encode(errors="replace").decode()  # half a character is no text elsewhere
        content = self.content(changes.apply(self.fit(motion)), skeleton, title, changes)
        with replacing(path) as temporary:
            temporary.write_bytes(content)


def format_of(path: str | Path) -> str:
    """Find the ending of a file's name that says its format, one of `FORMATS`; raises ValueError for another."""
    name = Path(path).name
    found = [ending for ending in FORMATS if name.endswith(ending)]
    if not found:
        suffix, known = Path(path).suffix, ", ".join(FORMATS)
        raise ValueError(f"cannot save a motion as {name!r}: unknown suffix {suffix!r}, choose one of {known}")
    return max(found, key=len)


def check(path: str | Path, skeleton: Skeleton, changes: Changes | None = None) -> None:
    """Refuse what `save` would refuse of any motion of a skeleton, before one is made.

    Raises ValueError for a format that has no place for the skeleton or for changes, or for FBX without Blender;
    ImportError for pictures without the libraries that draw them.
    """
    kind = FORMATS[format_of(path)]
    kind.check(Path(path).name, skeleton, changes or Changes())
    kind.require()


def save(motion: Motion, path: str | Path, changes: Changes | None = None) -> Path:
    """Save one motion by the ending of `path` (see `FORMATS`).

    Formats of rotations (`RIGGED`) fit them to the joints and may be changed: raises ValueError for changes of another
    format, or a skeleton without a T-pose.
    """
    path, changes = Path(path), changes or Changes()
    kind = FORMATS[format_of(path)]
    kind.check(path.name, get_skeleton(motion.skeleton), changes)
    kind.write(motion, path, changes)
    return path


def _require_film() -> None:
    require_matplotlib()
    require_encoder()


RIGGED = {
    ".bvh": Rigged(lambda rig, skeleton, title, changes: bvh_text(rig, unit=changes.unit).encode(), free=True),
    ".glb": Rigged(lambda rig, skeleton, title, changes: glb_bytes(rig, skeleton, title=title)),
    ".vrma": Rigged(lambda rig, skeleton, title, changes: vrma_bytes(rig, title=title)),
    ".fbx": Rigged(
        lambda rig, skeleton, title, changes: fbx_bytes(rig, skeleton, title=title), require=require_blender
    ),
    ".amass.npz": Rigged(lambda rig, skeleton, title, changes: amass_bytes(rig, title=title), smpl_rest_pose),
}
"""Formats of rotations by the ending of their files' names."""
PLAIN = {
    ".html": Plain(lambda motion, path: save_html([motion], path, title=motion.text or "Kinema motion")),
    ".mp4": Plain(save_mp4, _require_film),
    ".png": Plain(save_strip, require_matplotlib),
    ".npy": Plain(save_npy),
    ".npz": Plain(save_npz),
}
FORMATS: dict[str, Format] = {**PLAIN, **RIGGED}
"""Formats by the endings of the names that a motion can be saved under."""

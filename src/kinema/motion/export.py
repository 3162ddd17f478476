"""Save a motion in the format its file name asks for."""

from __future__ import annotations

from pathlib import Path

from kinema.motion.formats.arrays import save_npy, save_npz
from kinema.motion.formats.bvh import save_bvh
from kinema.motion.formats.glb import save_glb, save_vrma
from kinema.motion.view.html import save_html
from kinema.motion.view.video import save_mp4, save_strip
from kinema.types import Motion


def save(motion: Motion, path: str | Path) -> Path:
    """Save one motion by the suffix of `path` (see `FORMATS`)."""
    path = Path(path)
    if path.suffix not in FORMATS:
        known = ", ".join(FORMATS)
        raise ValueError(
            f"cannot save a motion as {path.name!r}: unknown suffix {path.suffix!r}, choose one of {known}"
        )
    return FORMATS[path.suffix](motion, path)


FORMATS = {
    ".html": lambda motion, path: save_html([motion], path, title=motion.text or "Kinema motion"),
    ".mp4": save_mp4,
    ".png": save_strip,
    ".npy": save_npy,
    ".npz": save_npz,
    ".bvh": save_bvh,
    ".glb": save_glb,
    ".vrma": save_vrma,
}

"""Read and write motion as NumPy files: joints alone (.npy), or all that a motion holds (.npz)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from kinema.atomic import replacing
from kinema.files.arrays import NUMBERS, Wanted, read_npy, read_npz
from kinema.motion.skeleton import get_skeleton
from kinema.types import Motion

PARTS = frozenset({"joints", "features", "text", "fps", "skeleton"})
"""Names that every motion of ours has as .npz."""

_LAYOUT = {
    "joints": Wanted(shape=(None, None, 3)),
    "features": Wanted(shape=(None, None)),
    "text": Wanted("U", ()),
    "fps": Wanted(shape=()),
    "skeleton": Wanted("U", ()),
    "seed": Wanted("iu", (), optional=True),
    "kept": Wanted("b", (None,), optional=True),
}


def save_npy(motion: Motion, path: str | Path) -> Path:
    """Write the joints alone: float32 (frames, joints, 3) in the skeleton's unit."""
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.save(file, np.asarray(motion.joints, dtype=np.float32), allow_pickle=False)
    return Path(path)


def save_npz(motion: Motion, path: str | Path) -> Path:
    """Write all that a motion holds: joints, features, text, fps, skeleton; if it has them, seed and kept frames."""
    content: dict[str, Any] = {
        "joints": np.asarray(motion.joints, dtype=np.float32),
        "features": np.asarray(motion.features, dtype=np.float32),
        "text": np.array(motion.text),
        "fps": np.array(motion.fps, dtype=np.float64),
        "skeleton": np.array(motion.skeleton),
    }
    if motion.seed is not None:
        content["seed"] = np.array(motion.seed, dtype=np.int64)
    if motion.kept is not None:
        content["kept"] = motion.kept
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **content)
    return Path(path)


def load_npy(path: str | Path) -> np.ndarray:
    """Read joints (frames, joints, 3) as float32; pickled content is refused."""
    joints = read_npy(path, Wanted(NUMBERS), fix="save joints (frames, joints, 3) with np.save")
    if joints.ndim != 3 or joints.shape[2] != 3:
        found = f"{joints.dtype} {joints.shape}"
        raise ValueError(f"{path} should hold joint positions of shape (frames, joints, 3); it holds {found}")
    return joints.astype(np.float32)


def load_npz(path: str | Path) -> Motion:
    """Read a motion that `save` wrote as .npz; pickled content is refused."""
    content = read_npz(path, _LAYOUT, fix="write it again with kinema.motion.export.save")
    _check_agreement(path, content)
    return Motion(
        joints=content["joints"],
        features=content["features"],
        text=str(content["text"]),
        skeleton=str(content["skeleton"]),
        fps=float(content["fps"]),
        seed=int(content["seed"]) if "seed" in content else None,
        kept=content.get("kept"),
    )


def _check_agreement(path: str | Path, content: dict[str, np.ndarray]) -> None:
    """Raise ValueError for parts that are not of one motion."""
    lengths = {name: len(content[name]) for name in ("joints", "features", "kept") if name in content}
    if len(set(lengths.values())) > 1:
        found = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise ValueError(f"{path} holds parts of several motions (frames: {found}); write it again with `save`")
    skeleton, fps = get_skeleton(str(content["skeleton"])), float(content["fps"])
    if fps != skeleton.fps:
        raise ValueError(
            f"{path} has fps={fps:g}, and {skeleton.name}'s motion has {skeleton.fps:g}: save its joints alone as "
            ".npy, and give --fps"
        )

"""Read and write motion as NumPy files: joints alone (.npy), or all that a motion holds (.npz)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from kinema.atomic import replacing
from kinema.types import Motion


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
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no such file: {path}")
    try:
        joints = np.load(path, allow_pickle=False)
    except (ValueError, EOFError, OSError) as error:
        raise ValueError(f"{path} is not a plain .npy array of numbers: {error}") from error
    if not isinstance(joints, np.ndarray) or joints.ndim != 3 or joints.shape[2] != 3 or joints.dtype.kind not in "fiu":
        found = f"{joints.dtype} {joints.shape}" if isinstance(joints, np.ndarray) else "an archive (use load_npz)"
        raise ValueError(f"{path} should hold joint positions of shape (frames, joints, 3); it holds {found}")
    return joints.astype(np.float32)


def load_npz(path: str | Path) -> Motion:
    """Read a motion that `save` wrote as .npz; pickled content is refused."""
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no such file: {path}")
    try:
        archive = np.load(path, allow_pickle=False)
        content = dict(archive) if isinstance(archive, np.lib.npyio.NpzFile) else {}
    except (ValueError, EOFError, OSError) as error:
        raise ValueError(f"{path} is not a motion archive: {error}") from error
    missing = {"joints", "features", "text", "fps", "skeleton"} - content.keys()
    if missing:
        raise ValueError(f"{path} is not a motion archive: it lacks {', '.join(sorted(missing))}")
    return Motion(
        joints=content["joints"],
        features=content["features"],
        text=str(content["text"]),
        skeleton=str(content["skeleton"]),
        fps=float(content["fps"]),
        seed=int(content["seed"]) if "seed" in content else None,
        kept=content.get("kept"),
    )

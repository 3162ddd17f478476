"""Read the motions that an evaluation kept to be watched."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kinema.motion.skeleton import get_skeleton
from kinema.types import Motion


def read_samples(path: Path) -> list[Motion]:
    """Read the motions that an evaluation kept."""
    if not path.exists():
        return []
    with np.load(path, allow_pickle=False) as file:
        name = str(file["skeleton"])
        fps = get_skeleton(name).fps
        return [
            Motion(file[f"joints{i}"], np.zeros((len(file[f"joints{i}"]), 0), np.float32), str(text), name, fps)
            for i, text in enumerate(file["texts"])
        ]

"""Read the motions that an evaluation kept to be watched."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kinema.motion.skeleton import get_skeleton
from kinema.types import Motion


def read_samples(path: Path) -> list[Motion]:
    """Read the motions that an evaluation kept; edits know which frames are the clip's own (older files don't)."""
    if not path.exists():
        return []
    with np.load(path, allow_pickle=False) as file:
        name = str(file["skeleton"])
        fps = get_skeleton(name).fps
        found = []
        for i, text in enumerate(file["texts"]):
            joints = file[f"joints{i}"]
            features = np.zeros((len(joints), 0), np.float32)
            found.append(Motion(joints, features, str(text), name, fps, kept=file.get(f"kept{i}")))
        return found

"""Read the motions that an evaluation kept to be watched."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kinema.files.arrays import Wanted, read_npz
from kinema.files.kinds import refuse
from kinema.motion.skeleton import SKELETONS
from kinema.types import Motion

FIX = "delete it with its replications.jsonl, and score that row again"


def read_samples(path: Path) -> list[Motion]:
    """Read the motions that an evaluation kept; edits know which frames are the clip's own (older files don't)."""
    if not path.exists():
        return []
    about = read_npz(path, {"skeleton": Wanted("U", ()), "texts": Wanted("U", (None,))}, fix=FIX)
    name, texts = str(about["skeleton"]), about["texts"].tolist()
    if name not in SKELETONS:
        raise refuse(path, f"is of an unknown skeleton {name!r}", FIX)
    body = SKELETONS[name]
    wanted = {f"joints{i}": Wanted("f", (None, body.num_joints, 3)) for i in range(len(texts))}
    wanted |= {f"kept{i}": Wanted("b", (None,), optional=True) for i in range(len(texts))}
    arrays = read_npz(path, wanted, fix=FIX)
    found = []
    for i, text in enumerate(texts):
        joints, kept = arrays[f"joints{i}"], arrays.get(f"kept{i}")
        if kept is not None and len(kept) != len(joints):
            raise refuse(path, f"keeps {len(kept)} frames of a motion of {len(joints)}", FIX)
        found.append(Motion(joints, np.zeros((len(joints), 0), np.float32), text, name, body.fps, kept=kept))
    return found

"""Read the motions that an evaluation kept to be watched, and write them for pages to read when they are looked at."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kinema.atomic import write_text
from kinema.motion.skeleton import get_skeleton
from kinema.motion.view.packed import broken_from, playable
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


def write_pack(motions: Sequence[Motion], folder: Path) -> dict[str, Any]:
    """Write motions as one script below `folder`, named by its content; gives its name there and what it holds.

    A page of file:// can fetch nothing but scripts: this one hands its motions to the viewer (viewer.js).
    """
    broken = [broken_from(motion) for motion in motions]
    data = [None if at is not None else playable(m) for m, at in zip(motions, broken, strict=True)]
    script = f"kinema.pack({json.dumps(data, separators=(',', ':'))});\n"
    name = hashlib.sha256(script.encode()).hexdigest()[:12]
    write_text(folder / "motions" / f"{name}.js", script)
    facts = [
        {"text": m.text, "frames": len(m.joints), "fps": m.fps, "broken": at, "edit": m.kept is not None}
        for m, at in zip(motions, broken, strict=True)
    ]
    return {"pack": f"motions/{name}.js", "motions": facts}

"""Write motions for pages to read when they are looked at: a script for each row of a table."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kinema.atomic import write_text
from kinema.motion.view.packed import broken_from, playable

if TYPE_CHECKING:
    from kinema.types import Motion


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


def sweep(folder: Path, packs: dict[str, dict[str, Any]]) -> None:
    """Delete the packs below `folder` that no row has any more."""
    kept = {pack["pack"] for pack in packs.values()}
    for path in sorted((folder / "motions").glob("*.js")):
        if f"motions/{path.name}" not in kept:
            path.unlink()

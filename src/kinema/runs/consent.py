"""Keep what this user asked runs to read outside of themselves: apart from the runs, which may come from anywhere."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shlex
from pathlib import Path


def ask(run: Path, part: str, where: str) -> None:
    """Remember that a part of a run is to be read from somewhere outside of it."""
    place = _place(run, part)
    with contextlib.suppress(OSError):  # a disk without links: then whoever loads the run is told
        place.parent.mkdir(parents=True, exist_ok=True)
        place.unlink(missing_ok=True)
        place.symlink_to(where)


def require_asked(run: Path, part: str, where: str, what: str) -> None:
    """Raise ValueError unless this user asked for a part of a run that lies outside of it, by training or importing.

    A symbolic link in the cache says so: what stands in the folder of a run is not followed.
    """
    place = _place(run, part)
    if not place.is_symlink() or os.readlink(place) != where:
        command = f"mkdir -p {shlex.quote(str(place.parent))} && ln -sfn {shlex.quote(where)} {shlex.quote(str(place))}"
        raise ValueError(f"{what} {where!r}, which lies outside; if you trust that: {command}")


def _place(run: Path, part: str) -> Path:
    """Name the link of a run's part; without KINEMA_CACHE it is the user's: runs are loaded from anywhere."""
    cache = Path(os.environ.get("KINEMA_CACHE") or os.path.expanduser("~/.cache/kinema")).absolute()
    name = hashlib.sha256(json.dumps([str(run.resolve()), part]).encode()).hexdigest()[:32]
    return cache / "asked" / name

"""Say of a clip which take it was cut from and where, as the corpus tells it (HUMANML3D_DATA §2, OPEN_MOCAP)."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinema.files.csv import read_csv

CUT = 180
"""Frames of a piece: `<name>_s<k>` is frames [180 k, 180 k + 180) of `<name>` (OPEN_MOCAP)."""

SOURCE_FIELDS = ("source clip", "source_clip", "source_path")
"""Fields of a manifest that name a clip's recording, but not its frames there."""

ORIGIN = np.dtype([("take", "<i4"), ("start", "<i4"), ("stop", "<i4")])
"""One origin: a take by number (-1: not known) and frames [start, stop) of it."""


@dataclass(frozen=True)
class Origin:
    """Hold a take (a source file) and frames [start, stop) of it; without `stop`, as far as the clip goes."""

    take: str
    start: int = 0
    stop: int | None = None

    def ending(self, frames: int) -> Origin:
        """Return the origin of a clip of so many frames; what is known of its end stays."""
        return self if self.stop is not None else Origin(self.take, self.start, self.start + frames)


def index_file(folder: Path) -> Path | None:
    """Find `index.csv` in a corpus folder, or beside it as HumanML3D ships it; None if there is none."""
    here = folder.absolute()
    return next((place / "index.csv" for place in (here, here.parent) if (place / "index.csv").is_file()), None)


def read_index(folder: Path) -> dict[str, Origin]:
    """Read where each clip was cut from: source_path, start_frame, end_frame (not included), new_name.

    Frames are those of the take at the corpus' rate, after what is dropped from its head. A file that was not cut
    (HumanAct12) may say so by an end before its start. Empty if the folder has no index. Raises ValueError for frames
    that are no numbers.
    """
    file = index_file(folder)
    if file is None:
        return {}
    rows = read_csv(file, "source_path", "new_name", fix="take it from HumanML3D's repository, or remove it")
    return {Path(r["new_name"]).stem: _origin(r, file) for r in rows if r.get("new_name") and r.get("source_path")}


def named_origin(name: str) -> Origin:
    """Read an origin from a clip's name: `NAME_sK` is a piece of the take `NAME`, any other a take of its own."""
    piece = re.fullmatch(r"(.+)_s(\d+)", name)
    return Origin(piece[1], CUT * int(piece[2])) if piece else Origin(name)


def tabulate(origins: Sequence[Origin | None]) -> tuple[np.ndarray, list[str]]:
    """Write origins as rows of `ORIGIN` and the takes that they number; a clip of unknown length counts one frame."""
    takes: dict[str, int] = {}
    rows = np.full(len(origins), -1, dtype=ORIGIN)
    for row, origin in enumerate(origins):
        if origin is not None:
            stop = origin.ending(1).stop
            rows[row] = takes.setdefault(origin.take, len(takes)), origin.start, stop
    return rows, list(takes)


def _origin(row: dict[str, str], file: Path) -> Origin:
    try:
        start, stop = int(float(row["start_frame"])), int(float(row["end_frame"]))
    except (KeyError, TypeError, ValueError):
        told = f"start_frame {row.get('start_frame')!r}, end_frame {row.get('end_frame')!r}"
        raise ValueError(f"{file}: {row['new_name']} has {told}; write numbers of frames") from None
    return Origin(row["source_path"], max(start, 0), stop if stop > start else None)

"""Read a way over the floor from a file: a place for every frame, or waypoints with times."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.interpolate import PchipInterpolator

from kinema.files.arrays import NUMBERS, Wanted, read_npy, read_npz
from kinema.files.csv import read_csv

MOST = 1e4
"""Metres from the origin and seconds beyond which a way is taken to be written in other units."""
FIX = (
    "write a .csv with the columns x, z and, if need be, heading and time; an .npy of (frames, 2 or 3); or an .npz of "
    "path (n, 2 or 3) and times (n)"
)


@dataclass(frozen=True)
class Waypoints:
    """Hold places (x, z in metres) by their times (seconds from 0), and headings (radians from +Z towards +X) or None.

    Between waypoints the way is smooth and never swings over (monotone cubics).
    """

    times: Float[np.ndarray, " n"]
    places: Float[np.ndarray, "n 2"]
    headings: Float[np.ndarray, " n"] | None

    @property
    def seconds(self) -> float:
        """How long it takes."""
        return float(self.times[-1])

    @property
    def length(self) -> float:
        """How long it is, from waypoint to waypoint, in metres."""
        return float(np.linalg.norm(np.diff(self.places, axis=0), axis=-1).sum())

    def frames(self, fps: float) -> int:
        """Count its frames, the first and the last included."""
        return round(self.seconds * fps) + 1

    def at(self, count: int) -> tuple[Float[np.ndarray, "t 2"], Float[np.ndarray, " t"] | None]:
        """Return place and heading in so many frames, over the whole way."""
        when = np.linspace(0, self.seconds, count)
        headings = None if self.headings is None else PchipInterpolator(self.times, self.headings)(when)
        return PchipInterpolator(self.times, self.places)(when), headings


def read_waypoints(path: str | Path, fps: float) -> Waypoints:
    """Read a way; rows without times are one a frame at `fps`, headings are in degrees.

    Raises FileNotFoundError, or ValueError that names the file, what is wrong and what is read.
    """
    path = Path(path)
    if path.suffix not in READERS:
        raise ValueError(f"{path} is no way over the floor that is read; {FIX}")
    values, times = READERS[path.suffix](path)
    if values.shape[1] not in (2, 3) or len(values) < 2:
        raise ValueError(f"{path} holds {values.shape}; at least two rows of x, z or x, z, heading are needed; {FIX}")
    times = np.arange(len(values)) / fps if times is None else times
    if times.shape != (len(values),) or not np.isfinite(values).all() or not np.isfinite(times).all():
        raise ValueError(f"{path} lacks numbers or holds NaN: every row needs its own; {FIX}")
    if (np.diff(times) <= 0).any():
        raise ValueError(
            f"{path}: times must rise from row to row, row {int((np.diff(times) <= 0).argmax()) + 2} doesn't"
        )
    far, long = np.abs(values[:, :2]).max(), times[-1] - times[0]
    if max(far, long) > MOST:
        raise ValueError(f"{path} goes {far:g} m far in {long:g} s; allowed: up to {MOST:g} of metres and of seconds")
    headings = np.unwrap(np.radians(values[:, 2])) if values.shape[1] == 3 else None
    return Waypoints(times - times[0], values[:, :2], headings)


def _from_csv(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    rows = read_csv(path, "x", "z", fix=FIX)
    names = ["x", "z", *(["heading"] if rows and "heading" in rows[0] else [])]
    columns = [*names, *(["time"] if rows and "time" in rows[0] else [])]
    try:
        values = np.array([[float(row[name]) for name in columns] for row in rows], dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path} holds what is no number ({error}); {FIX}") from None
    values = values.reshape(len(rows), len(columns))
    return values[:, : len(names)], values[:, -1] if "time" in columns else None


def _from_npz(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    wanted = {"path": Wanted(NUMBERS, (None, None)), "times": Wanted(NUMBERS, (None,), optional=True)}
    found = read_npz(path, wanted, fix=FIX)
    times = found.get("times")
    return found["path"].astype(np.float64), None if times is None else times.astype(np.float64)


READERS = {
    ".csv": _from_csv,
    ".npy": lambda path: (read_npy(path, Wanted(NUMBERS, (None, None)), fix=FIX).astype(np.float64), None),
    ".npz": _from_npz,
}
"""By suffix: (rows of x, z and perhaps heading; their times, if they have any)."""

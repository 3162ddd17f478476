"""Read a way over the floor from a file: a place for every frame, or waypoints with times."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.interpolate import PchipInterpolator

from kinema.files.arrays import NUMBERS, Wanted, read_npy, read_npz
from kinema.files.csv import read_csv

MOST = 1e4
"""Metres from the origin and seconds beyond which a way is taken to be written in other units."""
TALL = 2.0
"""Metres between the lowest and the highest root beyond which a column without a name is taken for no heights."""
FIX = (
    "write a .csv with the columns x, z and, if need be, heading and time; an .npy of (frames, 2): x, z, or of "
    "(frames, 3): x, y, z; or an .npz of such a path and, if need be, headings (n) and times (n)"
)


@dataclass(frozen=True)
class Waypoints:
    """Hold places (x, z in metres) by their times (seconds from 0), and headings (radians from +Z towards +X) or None.

    Between waypoints the way is smooth and never swings over (monotone cubics). `note` says how a file was read.
    """

    times: Float[np.ndarray, " n"]
    places: Float[np.ndarray, "n 2"]
    headings: Float[np.ndarray, " n"] | None
    note: str = ""

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


@dataclass(frozen=True)
class _Columns:
    """Hold what a file has: floats, one a row each; `named`: the file itself says which column is which."""

    x: np.ndarray
    z: np.ndarray
    y: np.ndarray | None = None
    heading: np.ndarray | None = None
    time: np.ndarray | None = None
    named: bool = True

    def note(self, fps: float) -> str:
        """Say in one line what is read and what isn't."""
        read = f"x, z{'' if self.heading is None else ', heading'} of each row"
        times = f"one row a frame of {fps:g} a second" if self.time is None else "at their times"
        heights = "" if self.y is None else f"; heights (y, {self.y.min():.2f} to {self.y.max():.2f} m) are left out"
        return f"{read}, {times}{heights}"


def read_waypoints(path: str | Path, fps: float) -> Waypoints:
    """Read a way; rows without times are one a frame at `fps`, headings are in degrees and have their name.

    Three columns without names are places in space, x, y, z, as everywhere. Raises FileNotFoundError, or ValueError
    that names the file, what is wrong and what is read.
    """
    path = Path(path)
    if path.suffix not in READERS:
        raise ValueError(f"{path} is no way over the floor that is read; {FIX}")
    found = READERS[path.suffix](path)
    given = [column for column in (found.x, found.z, found.y, found.heading, found.time) if column is not None]
    if len(found.x) < 2:
        raise ValueError(f"{path} holds {len(found.x)} rows; at least two rows of x, z are needed; {FIX}")
    if any(column.shape != found.x.shape or not np.isfinite(column).all() for column in given):
        raise ValueError(f"{path} lacks numbers or holds NaN: every row needs its own; {FIX}")
    if found.y is not None and not found.named and np.ptp(found.y) > TALL:
        raise ValueError(
            f"{path}: the second of three columns without names is the height (x, y, z), and goes from "
            f"{found.y.min():g} to {found.y.max():g} m; leave heights out, or name headings: {FIX}"
        )
    times = np.arange(len(found.x)) / fps if found.time is None else found.time
    if (np.diff(times) <= 0).any():
        raise ValueError(
            f"{path}: times must rise from row to row, row {int((np.diff(times) <= 0).argmax()) + 2} doesn't"
        )
    places = np.stack([found.x, found.z], axis=-1)
    far, long = np.abs(places).max(), times[-1] - times[0]
    if max(far, long) > MOST:
        raise ValueError(f"{path} goes {far:g} m far in {long:g} s; allowed: up to {MOST:g} of metres and of seconds")
    headings = None if found.heading is None else np.unwrap(np.radians(found.heading))
    return Waypoints(times - times[0], places, headings, found.note(fps))


def _from_csv(path: Path) -> _Columns:
    rows = read_csv(path, "x", "z", fix=FIX)
    names = [name for name in ("x", "z", "y", "heading", "time") if rows and name in rows[0]]
    try:
        values = {name: np.array([float(row[name]) for row in rows]) for name in names}
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path} holds what is no number ({error}); {FIX}") from None
    x, z = (values.get(name, np.zeros(0)) for name in ("x", "z"))
    return _Columns(x, z, values.get("y"), values.get("heading"), values.get("time"))


def _from_npz(path: Path) -> _Columns:
    rows = Wanted(NUMBERS, (None,), optional=True)
    wanted = {"path": Wanted(NUMBERS, (None, None)), "headings": rows, "times": rows}
    found = {name: array.astype(np.float64) for name, array in read_npz(path, wanted, fix=FIX).items()}
    return replace(_unnamed(path, found["path"]), heading=found.get("headings"), time=found.get("times"))


def _from_npy(path: Path) -> _Columns:
    return _unnamed(path, read_npy(path, Wanted(NUMBERS, (None, None)), fix=FIX).astype(np.float64))


def _unnamed(path: Path, values: Float[np.ndarray, "n c"]) -> _Columns:
    """Take columns by their number: places on the floor or in space."""
    if values.shape[1] not in (2, 3):
        raise ValueError(f"{path} holds {values.shape}; two columns are x, z, three x, y, z; {FIX}")
    height = values[:, 1] if values.shape[1] == 3 else None
    return _Columns(values[:, 0], values[:, -1], height, named=False)


READERS = {".csv": _from_csv, ".npy": _from_npy, ".npz": _from_npz}
"""By suffix: what reads the columns."""

"""Read a joints folder's own list of its clips: what it says of each, the frame rate among it."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from kinema.data.slips import STRAY, Slip
from kinema.files.json import fault, read_json
from kinema.files.kinds import refuse

MANIFEST = "manifest.json"
FIX = 'write a list of objects, each with a "name"'

PASSED = ("name", "frames", "split")
"""Keys that say nothing that the lists and arrays don't."""
READ = ("name", "fps")
"""Keys that mean something to the reader: in another case they would have no effect."""


@dataclass(frozen=True)
class Manifest:
    """Hold fields by clip; empty where a folder has no manifest."""

    fields: Mapping[str, dict[str, str]] = field(default_factory=dict)

    def of(self, name: str) -> dict[str, str]:
        """Return what is known of a clip."""
        return self.fields.get(name, {})

    def fps(self, name: str) -> float | None:
        """Return a clip's rate, None where it isn't told. Raises ValueError for one that is no positive number."""
        told = self.of(name).get("fps", "")
        try:
            rate = float(told) if told else None
        except ValueError:
            rate = 0.0
        if rate is not None and not 0 < rate < math.inf:
            raise ValueError(f"{MANIFEST}: clip {name!r} has fps {told!r}; write a positive number")
        return rate

    def strays(self, clips: Collection[str]) -> list[Slip]:
        """Name the entries that are of none of the clips."""
        return [Slip(MANIFEST, None, STRAY, repr(name)) for name in self.fields if name not in clips]


def read_clip_fields(folder: Path) -> Manifest:
    """Read a folder's manifest; `NAME.npy` is read as `NAME`.

    Raises ValueError for a row without a name, a clip with two rows, or a key that is read in another spelling.
    """
    file = folder / MANIFEST
    if not file.is_file():
        return Manifest()
    found: dict[str, dict[str, str]] = {}
    for number, row in enumerate(read_json(file, list, fix=FIX), 1):
        if isinstance(row, dict):
            for key in row:
                if (plain := key.strip().lower()) in READ and key not in READ:
                    raise refuse(file, f"has a clip, number {number}, with {key!r}", f'write "{plain}"')
        if wrong := fault(row, {"name": str}):
            raise refuse(file, f"has a clip, number {number}, that {wrong}", FIX)
        name = row["name"].removesuffix(".npy")
        if name in found:
            raise refuse(file, f"has clip {name!r} twice, again as number {number}", "write one object a clip")
        found[name] = {key: str(value) for key, value in row.items() if key not in PASSED and value is not None}
    return Manifest(found)

"""Open a packed corpus: one memory-mapped array of frames, and an index that is memory-mapped too."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from kinema.data.catalog import SPLITS
from kinema.data.integrity import FEATURES, FIX, check_features, check_files
from kinema.data.origin import ORIGIN, Origin
from kinema.files.arrays import Wanted, map_npy
from kinema.files.json import Each, fault, read_json
from kinema.files.kinds import refuse
from kinema.motion.skeleton import SKELETONS, Skeleton, get_skeleton
from kinema.motion.statistics import Statistics
from kinema.types import Caption

FORMAT = 1
"""Raised when the files of a store change their meaning."""

CLIP = np.dtype([("offset", "<i8"), ("frames", "<i4"), ("split", "u1"), ("mirrored", "?"), ("name", "<i4")])
"""One clip: its rows in `features`, and its name in the string table."""

ENTRY = np.dtype(
    [
        ("offset", "<i8"),
        ("frames", "<i4"),
        ("split", "u1"),
        ("mirrored", "?"),
        ("clip", "<i4"),
        ("caption", "<i4"),
        ("captions", "<i4"),
        ("part", "<i2"),
    ]
)
"""One entry: its rows in `features`, its clip, its captions (first and count), and its part (-1: the whole clip)."""

CAPTION = np.dtype([("text", "<i4"), ("tokens", "<i4")])
"""One caption: text and tokens in the string table."""

TABLES = ("clips.npy", "entries.npy", "captions.npy", "string_ends.npy", "strings.utf8", "fields.npy", "fields.json")
FILES = {FEATURES, "statistics.npz", "dropped.json", *TABLES}
MANIFEST = {
    "name": str,
    "hash": str,
    "skeleton": str,
    "frames": int,
    "fields": list,
    "options": {"request": str | None},
    "sizes": Each(int),
    "checksums": Each(str),
}
"""What is read of a store's manifest."""


class PackedStore:
    """Read a packed corpus; opening costs milliseconds, and workers and ranks share its pages.

    A **clip** is one motion, an **entry** what a text-to-motion method is trained and scored on: a clip with the
    captions that are about all of it, or a time-tagged part with its one caption. Windows are cut from clips, which
    have no length filter; entries have passed the skeleton's.

    `clips` and `entries` are structured arrays, e.g. `store.entries["frames"]`; `split` holds indices into `SPLITS`.
    Raises FileNotFoundError, or ValueError naming a file that is not as it was written; `checked` trusts them.
    """

    def __init__(self, path: str | Path, *, checked: bool = False) -> None:
        self.path = Path(path)
        self.manifest: dict[str, Any] = read_manifest(self.path)
        self.skeleton: Skeleton = get_skeleton(self.manifest["skeleton"])
        shape = (self.manifest["frames"], self.skeleton.feature_width)
        if not checked:
            check_files(self.path, self.manifest)
        if 4 * shape[0] * shape[1] != self.manifest["sizes"][FEATURES]:
            raise refuse(self.path / "manifest.json", f"says {shape[0]} frames, which {FEATURES} has not", FIX)
        self.statistics = Statistics.load(self.path / "statistics.npz")
        self.features: np.memmap = np.memmap(self.path / FEATURES, dtype="<f4", mode="r", shape=shape)
        self.clips = self._table("clips.npy", CLIP)
        self.entries = self._table("entries.npy", ENTRY)
        for name, rows in (("clips.npy", self.clips), ("entries.npy", self.entries)):
            if ((rows["offset"] < 0) | (rows["frames"] < 0) | (rows["offset"] + rows["frames"] > shape[0])).any():
                raise refuse(self.path / name, f"names rows outside the {shape[0]} of the features", FIX)

    @classmethod
    def open(cls, path: str | Path) -> PackedStore:
        """Open a store that `prepare` wrote."""
        return cls(path)

    @property
    def name(self) -> str:
        """Name the corpus."""
        return self.manifest["name"]

    @property
    def hash(self) -> str:
        """The short hash of motion as it was read, index, captions and skeleton: the same on every machine."""
        return self.manifest["hash"]

    @property
    def fields(self) -> tuple[str, ...]:
        """Name what is known of every clip, e.g. source, label, licence."""
        return tuple(self.manifest["fields"])

    @property
    def num_clips(self) -> int:
        """Count the clips."""
        return len(self.clips)

    @property
    def num_entries(self) -> int:
        """Count the entries, those without captions included."""
        return len(self.entries)

    def split_clips(self, split: str) -> np.ndarray:
        """Return the ids of a split's clips."""
        return np.flatnonzero(self.clips["split"] == _split_index(split))

    def split_entries(self, split: str, *, captions_required: bool = True) -> np.ndarray:
        """Return the ids of a split's entries, by default only of those that have a caption."""
        chosen = self.entries["split"] == _split_index(split)
        return np.flatnonzero(chosen & (self.entries["captions"] > 0) if captions_required else chosen)

    def frames_of(self, entry: int) -> np.ndarray:
        """Return an entry's full-width features as a view, no copy."""
        return self._rows_of(self.entries[entry])

    def clip_frames(self, clip: int) -> np.ndarray:
        """Return a clip's full-width features as a view, no copy."""
        return self._rows_of(self.clips[clip])

    def clip_name(self, clip: int) -> str:
        """Name a clip."""
        return self._string(self.clips[clip]["name"])

    def entry_name(self, entry: int) -> str:
        """Name an entry: its clip's name, and for a time-tagged part its number."""
        row = self.entries[entry]
        name = self.clip_name(row["clip"])
        return name if row["part"] < 0 else f"{name}#{row['part']}"

    def entry_captions(self, entry: int) -> list[Caption]:
        """Return an entry's captions."""
        row = self.entries[entry]
        return [self.caption(i) for i in range(row["caption"], row["caption"] + row["captions"])]

    def caption(self, index: int) -> Caption:
        """Return one caption of the corpus."""
        text, tokens = self._captions[index]
        return Caption(self._string(text), tuple(self._string(tokens).split()))

    def entry_field(self, entry: int, field: str) -> str:
        """Return a field of an entry's clip; empty where the clip has none."""
        return self.clip_field(self.entries[entry]["clip"], field)

    def clip_field(self, clip: int, field: str) -> str:
        """Return a field of a clip; empty where the clip has none."""
        if field not in self.fields:
            raise ValueError(f"corpus {self.name!r} has no field {field!r}; it has {list(self.fields)}")
        return self._field_values[field][self._field_codes[clip, self.fields.index(field)]]

    @cached_property
    def origins(self) -> np.ndarray:
        """The take of every clip and its frames there, rows of `ORIGIN`; none known in a store without the files."""
        if "origins.npy" not in self.manifest["sizes"]:
            return np.full(self.num_clips, -1, dtype=ORIGIN)
        return self._table("origins.npy", ORIGIN)

    def clip_origin(self, clip: int) -> Origin | None:
        """Return where a clip was cut from, None where the corpus doesn't say."""
        take, start, stop = self.origins[clip].tolist()
        return None if take < 0 else Origin(self._takes[take], start, stop)

    @cached_property
    def dropped(self) -> list[dict[str, Any]]:
        """List what was left out: name, split, what (missing, clip, entry, caption), reason."""
        return read_json(self.path / "dropped.json", list, fix=FIX)

    @property
    def knowledge(self) -> str | None:
        """The short hash of what is known of clips beside motion and captions, fields and takes; None: nothing is."""
        sums = self.manifest["checksums"]
        known = [sums[name] for name in ("fields.json", "fields.npy") if self.fields]
        known += [sums[name] for name in ("origins.npy", "takes.json") if name in sums]
        return hashlib.sha256(" ".join(known).encode()).hexdigest()[:12] if known else None

    def verify(self) -> None:
        """Read the features too and renew their stamp; raises ValueError if they are not those that were written."""
        check_features(self.path, self.manifest)

    def __reduce__(self) -> tuple[Callable[[Path], PackedStore], tuple[Path]]:
        return _open_checked, (self.path,)

    def __repr__(self) -> str:
        return f"PackedStore({self.name!r}, {self.num_clips} clips, {self.num_entries} entries, hash {self.hash})"

    def _table(self, name: str, dtype: np.dtype, shape: tuple[int | None, ...] = (None,)) -> np.ndarray:
        return map_npy(self.path / name, Wanted(dtype, shape), fix=FIX)

    def _rows_of(self, row: np.void) -> np.ndarray:
        return self._rows[row["offset"] : row["offset"] + row["frames"]]

    @cached_property
    def _rows(self) -> np.ndarray:
        # A plain view: slicing np.memmap itself makes a memmap object per slice, which costs microseconds each.
        return self.features.view(np.ndarray)

    @cached_property
    def _captions(self) -> np.ndarray:
        return self._table("captions.npy", CAPTION)

    @cached_property
    def _takes(self) -> list[str]:
        return read_json(self.path / "takes.json", list, fix=FIX)

    @cached_property
    def _string_ends(self) -> np.ndarray:
        return self._table("string_ends.npy", np.dtype("<i8"))

    @cached_property
    def _blob(self) -> np.ndarray:
        return np.memmap(self.path / "strings.utf8", dtype="u1", mode="r").view(np.ndarray)

    def _string(self, index: int) -> str:
        start = self._string_ends[index - 1] if index else 0
        return self._blob[start : self._string_ends[index]].tobytes().decode("utf-8")

    @cached_property
    def _field_codes(self) -> np.ndarray:
        return self._table("fields.npy", np.dtype("<i4"), (self.num_clips, len(self.fields)))

    @cached_property
    def _field_values(self) -> dict[str, list[str]]:
        return read_json(self.path / "fields.json", Each(list), fix=FIX)


def _open_checked(path: Path) -> PackedStore:
    """Open a store that another process has just checked."""
    return PackedStore(path, checked=True)


def _split_index(split: str) -> int:
    if split not in SPLITS:
        raise ValueError(f"split {split!r} is not one of {SPLITS}")
    return SPLITS.index(split)


def read_manifest(path: Path) -> dict[str, Any]:
    """Read and check what a store says of itself; raises FileNotFoundError, or ValueError naming what is wrong."""
    file = path / "manifest.json"
    if not file.is_file():
        raise FileNotFoundError(
            f"{path} is no packed corpus (no manifest.json); make one with kinema.data.prepare.prepare_store(...)"
        )
    manifest = read_json(file, {"format": int}, fix=FIX)
    if manifest["format"] != FORMAT:
        raise ValueError(f"{file} has store format {manifest['format']}, this version reads {FORMAT}; prepare it again")
    if wrong := fault(manifest, MANIFEST):
        raise refuse(file, wrong, FIX)
    if manifest["skeleton"] not in SKELETONS:
        raise refuse(file, f"has the skeleton {manifest['skeleton']!r}, allowed: {', '.join(SKELETONS)}", FIX)
    # It names the folders of what is made of this corpus.
    if not re.fullmatch("[0-9a-f]{12}", manifest["hash"]):
        raise refuse(file, f"has the hash {manifest['hash']!r}, which is not 12 hex digits", FIX)
    odd = [name for name in (*manifest["sizes"], *manifest["checksums"]) if Path(name).name != name]
    lacking = FILES - (manifest["sizes"].keys() & manifest["checksums"].keys())
    if odd or lacking:
        what = f"names {odd[0]!r}, which is no file of its folder" if odd else f"does not name {min(lacking)}"
        raise refuse(file, what, FIX)
    return manifest

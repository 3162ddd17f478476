"""Write the files of a packed store, one clip at a time."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kinema.data.captions import AnnotatedCaption
from kinema.data.catalog import SPLITS, Clip, Dropped
from kinema.data.convert import VERSION as FEATURES
from kinema.data.integrity import checksum, write_stamp
from kinema.data.origin import Origin, tabulate
from kinema.data.store import CAPTION, CLIP, ENTRY, FORMAT
from kinema.motion.skeleton import Skeleton
from kinema.motion.statistics import Statistics
from kinema.types import Caption

ROWS = 1 << 16
"""Rows read at a time for the statistics: 69 MB of full-width features."""


class StoreWriter:
    """Write clips to a folder in the order they come; `finish` writes the index and the manifest.

    `tag_fps` turns the seconds of time-tagged captions into frames.
    """

    def __init__(self, folder: Path, name: str, skeleton: Skeleton, tag_fps: float) -> None:
        self.folder, self.name, self.skeleton, self.tag_fps = folder, name, skeleton, tag_fps
        self.frames = 0
        self._clips: list[tuple[int, int, int, bool, int]] = []
        self._entries: list[tuple[int, int, int, bool, int, int, int, int]] = []
        self._captions: list[tuple[int, int]] = []
        self._strings: dict[str, int] = {}
        self._fields: list[dict[str, str]] = []
        self._origins: list[Origin | None] = []
        self._dropped: list[Dropped] = []
        self._features_hash = hashlib.sha256()
        self._motion_hash = hashlib.sha256()
        self._index_hash = hashlib.sha256(f"kinema store {FORMAT} {FEATURES} {skeleton.name}".encode())
        self._file = (folder / "features.f32").open("wb")

    def close(self) -> None:
        """Close the features; needed where `finish` was not reached."""
        self._file.close()

    @property
    def dropped(self) -> list[Dropped]:
        """What was left out so far."""
        return self._dropped

    def drop(self, dropped: Dropped) -> None:
        """Note what was left out."""
        self._dropped.append(dropped)

    def add(self, clip: Clip, features: np.ndarray, digest: bytes) -> None:
        """Append a clip's full-width features, and its entries: itself, and its time-tagged parts.

        `digest` is that of the motion that the features were made from.
        """
        rows = np.ascontiguousarray(features, dtype="<f4")
        self._file.write(rows.data)
        self._features_hash.update(rows.data)
        self._motion_hash.update(digest)
        split = SPLITS.index(clip.split)
        self._clips.append((self.frames, len(rows), split, clip.mirrored, self._intern(clip.name)))
        self._fields.append(clip.fields)
        # n + 1 frames of joints make n rows of features.
        self._origins.append(clip.origin and clip.origin.ending(len(rows) + 1))
        entries, filtered = cut_entries(clip, len(rows), self.skeleton, self.tag_fps)
        self._dropped += filtered
        for entry in entries:
            self._add_entry(clip, entry)
        self.frames += len(rows)

    def finish(self, statistics: Statistics | None, options: dict[str, Any]) -> dict[str, Any]:
        """Write index, captions, statistics, the list of what was left out, and last the manifest, which it gives.

        Raises ValueError if no clip was added.
        """
        self._file.close()
        if not self._clips:
            first = self._dropped[0].reason if self._dropped else "the source lists none"
            raise ValueError(f"corpus {self.name!r} has no usable clip ({len(self._dropped)} left out, first: {first})")
        computed = Statistics.compute(self._chunks(), self.skeleton)
        (statistics or computed).save(self.folder / "statistics.npz")
        self._write_index()
        self._write_fields()
        self._write_origins()
        _dump(self.folder / "dropped.json", [vars(d) for d in self._dropped])
        content = self._content_hash(statistics)
        files = sorted(self.folder.iterdir())
        # Hashed while they were written: reading gigabytes again would cost more than all the rest.
        checksums = {f.name: checksum(f) for f in files if f.name != "features.f32"}
        checksums["features.f32"] = self._features_hash.hexdigest()
        manifest = {
            "format": FORMAT,
            "name": self.name,
            "hash": content[:12],
            "content_sha256": content,
            "skeleton": self.skeleton.name,
            "frames": self.frames,
            "hours": round(self.frames / self.skeleton.fps / 3600, 3),
            "splits": {split: self._count(i) for i, split in enumerate(SPLITS)},
            "fields": self._field_names(),
            "dropped": self._dropped_counts(),
            "statistics": _compare(statistics, computed),
            "options": options | {"tag_fps": self.tag_fps},
            "sizes": {f.name: f.stat().st_size for f in files},
            "checksums": checksums,
        }
        _dump(self.folder / "manifest.json", manifest)
        write_stamp(self.folder)
        return manifest

    def bytes_per_clip(self) -> float:
        """Return the mean size of the clips written so far, or that of the longest entry."""
        frames = self.frames / len(self._clips) if self._clips else self.skeleton.max_frames
        return 4 * self.skeleton.feature_width * frames

    def _content_hash(self, own: Statistics | None) -> str:
        """Hash motion, index, captions and skeleton, and statistics where they are not a function of these.

        Of the motion that was read, not of the features: those differ in the last bit between kinds of CPU.
        """
        whole = self._index_hash.copy()
        whole.update(self._motion_hash.digest())
        if own is not None:
            whole.update(own.digest().encode())
        return whole.hexdigest()

    def _add_entry(self, clip: Clip, entry: Entry) -> None:
        split, first = SPLITS.index(clip.split), len(self._captions)
        self._captions += [self._caption(c.caption) for c in entry.captions]
        where = (self.frames + entry.start, entry.frames, split, clip.mirrored)
        self._entries.append((*where, len(self._clips) - 1, first, len(entry.captions), entry.part))

    def _caption(self, caption: Caption) -> tuple[int, int]:
        return self._intern(caption.text), self._intern(" ".join(caption.tokens))

    def _intern(self, text: str) -> int:
        return self._strings.setdefault(text, len(self._strings))

    def _write_index(self) -> None:
        encoded = [text.encode("utf-8") for text in self._strings]
        tables = {
            "clips": np.array(self._clips, dtype=CLIP),
            "entries": np.array(self._entries, dtype=ENTRY),
            "captions": np.array(self._captions, dtype=CAPTION),
            "string_ends": np.cumsum([len(e) for e in encoded], dtype="<i8"),
        }
        for name, table in tables.items():
            np.save(self.folder / f"{name}.npy", table)
            self._index_hash.update(table.tobytes())
        blob = b"".join(encoded)
        (self.folder / "strings.utf8").write_bytes(blob)
        self._index_hash.update(blob)

    def _field_names(self) -> list[str]:
        return list(dict.fromkeys(name for fields in self._fields for name in fields))

    def _write_fields(self) -> None:
        """Write every field as codes into the list of its values; fields do not enter the content hash."""
        names = self._field_names()
        values: dict[str, dict[str, int]] = {name: {} for name in names}
        codes = np.zeros((len(self._fields), len(names)), dtype="<i4")
        for row, fields in enumerate(self._fields):
            for column, name in enumerate(names):
                codes[row, column] = values[name].setdefault(fields.get(name, ""), len(values[name]))
        np.save(self.folder / "fields.npy", codes)
        _dump(self.folder / "fields.json", {name: list(found) for name, found in values.items()})

    def _write_origins(self) -> None:
        """Write the takes that clips were cut from, if any is known; like fields they do not enter the content hash."""
        rows, takes = tabulate(self._origins)
        if takes:
            np.save(self.folder / "origins.npy", rows)
            _dump(self.folder / "takes.json", takes)

    def _chunks(self) -> Iterator[np.ndarray]:
        shape = (self.frames, self.skeleton.feature_width)
        features = np.memmap(self.folder / "features.f32", dtype="<f4", mode="r", shape=shape)
        yield from (features[start : start + ROWS] for start in range(0, self.frames, ROWS))

    def _count(self, split: int) -> dict[str, int]:
        clips = [c for c in self._clips if c[2] == split]
        entries = [e for e in self._entries if e[2] == split]
        return {
            "clips": len(clips),
            "frames": sum(c[1] for c in clips),
            "entries": sum(e[6] > 0 for e in entries),
            "entries_without_captions": sum(e[6] == 0 for e in entries),
            "captions": sum(e[6] for e in entries),
        }

    def _dropped_counts(self) -> dict[str, int]:
        counts = Counter(d.what for d in self._dropped)
        return {what: counts[what] for what in ("missing", "clip", "entry", "caption")}


@dataclass(frozen=True)
class Entry:
    """Hold frames [start, start + frames) of a clip and the captions about them; `part` -1 is the whole clip."""

    start: int
    frames: int
    captions: list[AnnotatedCaption]
    part: int


def cut_entries(clip: Clip, rows: int, skeleton: Skeleton, tag_fps: float) -> tuple[list[Entry], list[Dropped]]:
    """Cut a clip of so many rows into its entries, itself and its time-tagged parts; say which have no usable length.

    `tag_fps` turns the seconds of time-tagged captions into frames.
    """
    whole = [c for c in clip.captions if not c.tagged]
    tagged = [c for c in clip.captions if c.tagged]
    found = [Entry(0, rows, whole, -1)] if whole or not tagged else []
    for part, caption in enumerate(tagged):
        start, stop = (min(int(t * tag_fps), rows) for t in (caption.start, caption.end))
        found.append(Entry(start, stop - start, [caption], part))
    low, high = skeleton.min_frames, skeleton.max_frames
    kept, filtered = [], []
    for entry in found:
        if low <= entry.frames < high:
            kept.append(entry)
            continue
        times = f"({entry.captions[0].start:g} to {entry.captions[0].end:g} s)" if entry.part >= 0 else ""
        what = "the clip" if entry.part < 0 else f"part {entry.part} {times}"
        reason = f"{what} has {max(entry.frames, 0)} frames, entries need {low} <= frames < {high}"
        filtered.append(Dropped(clip.name, clip.split, "entry", reason))
    return kept, filtered


def _compare(own: Statistics | None, computed: Statistics) -> dict[str, Any]:
    """Say where the statistics come from, and how far a folder's own lie from those of its features.

    `mean_deviation` is in standard deviations; `std_ratio` is (least, greatest) of own over computed.
    """
    if own is None:
        return {"source": "computed", "digest": computed.digest()}
    ratio = own.std / computed.std
    return {
        "source": "folder",
        "digest": own.digest(),
        "mean_deviation": float(np.abs((own.mean - computed.mean) / computed.std).max()),
        "std_ratio": [float(ratio.min()), float(ratio.max())],
    }


def _dump(file: Path, value: Any) -> None:
    file.write_text(json.dumps(value, indent=1, ensure_ascii=False), encoding="utf-8")

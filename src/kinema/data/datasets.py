"""Serve windows and captioned crops of a packed store; what an item holds depends on (index, item seed) only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from torch.utils.data import Dataset

from kinema.data.store import PackedStore
from kinema.types import Caption


@dataclass
class Item:
    """Hold one crop: features (a view of the store), and where they come from (row of the index, first frame)."""

    features: Float[np.ndarray, "t d"]
    entry: int
    start: int
    name: str
    caption: Caption | None = None


class WindowDataset(Dataset[Item]):
    """Serve every window of every clip of a split, for tokenizers (MARDM §2).

    An item's `entry` is a row of `store.clips`. `legacy` reproduces the published item space: a clip's last start is
    never used, so that a clip of `window` frames contributes nothing, and items 0 and 1 are the same. `dims` names the
    columns that are served.
    """

    def __init__(
        self, store: PackedStore, split: str, window: int = 64, *, legacy: bool = False, dims: str = "redundant"
    ) -> None:
        if window < 1:
            raise ValueError(f"window must be at least 1 frame, not {window}")
        self.store, self.split, self.window, self.legacy = store, split, window, legacy
        self.width = store.skeleton.width_of(dims)
        clips = store.split_clips(split)
        frames = store.clips["frames"][clips]
        self.clips = clips[frames >= window]
        self.skipped = len(clips) - len(self.clips)
        self._ends = np.cumsum(frames[frames >= window].astype(np.int64) - window + (not legacy))
        if len(self) == 0:
            raise ValueError(
                f"corpus {store.name!r}, split {split!r}: none of {len(clips)} clips has {window} frames; use a "
                "smaller window or longer clips"
            )

    def __len__(self) -> int:
        return int(self._ends[-1]) if len(self._ends) else 0

    def locate(self, index: int) -> tuple[int, int]:
        """Return the row of `clips` (those long enough) and the first frame of an item."""
        if not 0 <= index < len(self):
            raise IndexError(f"item {index} of {len(self)}")
        if self.legacy:
            if index == 0:
                return 0, 0
            index -= 1
        row = int(np.searchsorted(self._ends, index, side="right"))
        return row, index - int(self._ends[row - 1] if row else 0)

    def __getitem__(self, item: tuple[int, int]) -> Item:
        row, start = self.locate(item[0])
        clip = int(self.clips[row])
        features = self.store.clip_frames(clip)[start : start + self.window, : self.width]
        return Item(features, clip, start, self.store.clip_name(clip))


class ClipDataset(Dataset[Item]):
    """Serve a crop and a caption of every entry of a split, for generators, evaluators and the test protocol.

    The crop's length is a multiple of `unit`: with probability 2/3 the greatest, with 1/3 one unit less; its start and
    the caption are uniform (MARDM §2). `min_frames` and `max_frames` (exclusive) narrow the store's length filter.
    `dims` names the columns that are served.
    """

    def __init__(
        self,
        store: PackedStore,
        split: str,
        *,
        min_frames: int | None = None,
        max_frames: int | None = None,
        unit: int = 4,
        captions_required: bool = True,
        dims: str = "redundant",
    ) -> None:
        self.store, self.split, self.unit = store, split, unit
        self.width = store.skeleton.width_of(dims)
        entries = store.split_entries(split, captions_required=captions_required)
        if captions_required and len(entries) == 0 and len(store.split_entries(split, captions_required=False)):
            raise ValueError(
                f"corpus {store.name!r}, split {split!r} has no captions, and this needs them; add texts/NAME.txt and "
                "prepare it again, or use its windows (tokenizers)"
            )
        frames = store.entries["frames"][entries]
        low = max(unit, store.skeleton.min_frames if min_frames is None else min_frames)
        high = store.skeleton.max_frames if max_frames is None else max_frames
        self.entries = entries[(frames >= low) & (frames < high)]
        if len(self.entries) == 0:
            raise ValueError(
                f"corpus {store.name!r}, split {split!r}: none of {len(entries)} entries has {low} <= frames < {high}; "
                "its manifest.json and dropped.json say what was left out"
            )

    def __len__(self) -> int:
        return len(self.entries)

    def __getitem__(self, item: tuple[int, int]) -> Item:
        index, seed = item
        entry = int(self.entries[index])
        row, draw = self.store.entries[entry], np.random.default_rng(seed)
        which = int(draw.integers(row["captions"])) if row["captions"] else None
        shorter = int(draw.integers(3) == 0)
        frames = crop_frames(int(row["frames"]), self.unit)[shorter]
        start = int(draw.integers(row["frames"] - frames + 1))
        caption = None if which is None else self.store.caption(int(row["caption"]) + which)
        features = self.store.frames_of(entry)[start : start + frames, : self.width]
        return Item(features, entry, start, self.store.entry_name(entry), caption)

    def crops(self, entry: int) -> list[tuple[int, int]]:
        """List the (start, frames) an entry's crops can have: at most 3 unit of them, so that latents can be cached."""
        length = int(self.store.entries[entry]["frames"])
        lengths = dict.fromkeys(crop_frames(length, self.unit))
        return [(start, frames) for frames in lengths for start in range(length - frames + 1)]


def crop_frames(length: int, unit: int) -> tuple[int, int]:
    """Return both lengths a crop can have: the greatest multiple of the unit, and one unit less (but not nothing)."""
    most = length // unit * unit
    return most, max(most - unit, unit)

"""Tell how near a clip is to training: the same take, the same frames, the same words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from kinema.data.origin import ORIGIN
from kinema.data.store import PackedStore

TAKE, FRAMES, CAPTION = "take seen in training", "frames seen in training", "caption seen in training"
HALF = 0.5


def takes_seen(tested: np.ndarray, trained: np.ndarray) -> Bool[np.ndarray, " n"]:
    """Tell of each tested clip whether training has a clip of its take; both are rows of `ORIGIN`."""
    return (tested["take"] >= 0) & np.isin(tested["take"], trained["take"])


def frames_seen(tested: np.ndarray, trained: np.ndarray) -> Float[np.ndarray, " n"]:
    """Return the share of each tested clip's frames that any training clip has; both are rows of `ORIGIN`.

    A clip whose take is not known shares none.
    """
    known = trained[(trained["take"] >= 0) & (trained["stop"] > trained["start"])]
    if not len(known) or not len(tested):
        return np.zeros(len(tested))
    # All takes one after the other on one axis, with a gap between two.
    size = 1 + max(int(known["stop"].max()), int(tested["stop"].max()))
    start, stop = (known["take"] * np.int64(size) + known[end] for end in ("start", "stop"))
    order = np.argsort(start, kind="stable")
    start, reach = start[order], np.maximum.accumulate(stop[order])
    opens = np.append(True, start[1:] > reach[:-1])
    edges = np.stack([start[opens], reach[np.append(opens[1:], True)]], axis=1).ravel()
    steps = np.diff(edges, prepend=edges[0])
    steps[::2] = 0  # between two stretches
    covered = np.cumsum(steps)
    first, last = (tested["take"] * np.int64(size) + tested[end] for end in ("start", "stop"))
    shared = np.interp(last, edges, covered) - np.interp(first, edges, covered)
    return np.where(tested["take"] >= 0, shared / np.maximum(last - first, 1), 0.0)


def entry_origins(store: PackedStore) -> np.ndarray:
    """Return the origin of every entry; that of a time-tagged part lies within its clip's."""
    clip = store.entries["clip"]
    rows = np.array(store.origins[clip], dtype=ORIGIN)
    part = (store.entries["part"] >= 0) & (rows["take"] >= 0)
    rows["start"][part] += (store.entries["offset"] - store.clips["offset"][clip])[part].astype("<i4")
    rows["stop"][part] = rows["start"][part] + store.entries["frames"][part]
    return rows


@dataclass(frozen=True)
class Nearness:
    """Hold how near a corpus' entries are to its training clips, mirrored ones included.

    `known` tells whether an entry's take is known, `take` whether training has it, `frames` the share of the entry's
    frames that training has; `captions` are training's.
    """

    known: Bool[np.ndarray, " n"]
    take: Bool[np.ndarray, " n"]
    frames: Float[np.ndarray, " n"]
    captions: frozenset[str]

    @classmethod
    def of(cls, store: PackedStore) -> Nearness:
        """Compare every entry of a corpus with its training clips."""
        rows, trained = entry_origins(store), store.origins[store.split_clips("train")]
        texts = (c.text for e in store.split_entries("train") for c in store.entry_captions(int(e)))
        return cls(rows["take"] >= 0, takes_seen(rows, trained), frames_seen(rows, trained), frozenset(texts))

    def fields(self, entries: Sequence[int], texts: Sequence[str]) -> dict[str, list[str]]:
        """Name what is seen of entries and the captions drawn for them; takes and frames where any is known."""
        found = {CAPTION: [_seen(text in self.captions) for text in texts]}
        if self.known.any():
            found[TAKE] = [_seen(self.take[e]) if self.known[e] else "unknown" for e in entries]
            found[FRAMES] = [_amount(self.frames[e]) if self.known[e] else "unknown" for e in entries]
        return found


def _seen(known: bool | np.bool_) -> str:
    return "seen" if known else "unseen"


def _amount(share: float) -> str:
    if share == 0:
        return "none"
    return "at least half" if share >= HALF else "under half"

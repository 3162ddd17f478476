"""Tell when a foot stands: its toe is low and slow, for long enough."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

LOW, SLOW = 0.06, 0.9
"""Metres above the floor and metres per second below which a toe is taken to stand."""
SHORTEST, GAP = 0.15, 0.1
"""Seconds: shorter contacts are left alone, gaps between contacts that are no longer are closed."""


def contacts(toe: Float[np.ndarray, "t 3"], fps: float) -> Bool[np.ndarray, " t"]:
    """Tell in which frames a toe stands."""
    speed = np.linalg.norm(np.gradient(toe[:, [0, 2]], axis=0), axis=-1) * fps if len(toe) > 1 else np.zeros(1)
    standing = (toe[:, 1] < LOW) & (speed < SLOW)
    standing = _without_short(~standing, round(GAP * fps) + 1, inside=True)
    return _without_short(~standing, round(SHORTEST * fps))


def runs(flags: Bool[np.ndarray, " t"]) -> list[tuple[int, int]]:
    """List the runs of true frames, [start, end)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _without_short(flags: Bool[np.ndarray, " t"], shortest: int, *, inside: bool = False) -> Bool[np.ndarray, " t"]:
    """Drop runs of fewer frames; `inside`: those that end the clip are kept."""
    kept = flags.copy()
    for start, end in runs(flags):
        if end - start < shortest and not (inside and (start == 0 or end == len(flags))):
            kept[start:end] = False
    return kept

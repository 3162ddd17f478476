"""Divide a corpus that has no lists of its own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kinema.data.catalog import SPLITS

GOLDEN = (np.sqrt(5) - 1) / 2


def split_of(index: int, shares: Sequence[float]) -> str:
    """Return the split of what is number `index`: the golden ratio spreads any number over about the wanted shares."""
    return SPLITS[int(np.searchsorted(np.cumsum(shares)[:2], ((index + 1) * GOLDEN) % 1.0, side="right"))]

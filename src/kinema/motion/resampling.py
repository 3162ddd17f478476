"""Bring joints from one frame rate to another."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def resampled(values: Float[np.ndarray, "t *n"], fps: float, wanted: float) -> Float[np.ndarray, "m *n"]:
    """Read positions at t = 0, 1/wanted, 2/wanted, ..., linearly between frames; whole ratios pick frames as they are.

    Raises ValueError for a rate that isn't positive.
    """
    if not (0 < fps < np.inf and 0 < wanted < np.inf):
        raise ValueError(f"cannot resample from {fps:g} to {wanted:g} frames per second; rates are positive numbers")
    if fps == wanted or len(values) == 0:
        return values
    count = int((len(values) - 1) / fps * wanted + 1e-6) + 1
    times = np.arange(count) * (fps / wanted)
    early = np.minimum(np.floor(times + 1e-9).astype(np.int64), len(values) - 1)
    late = np.minimum(early + 1, len(values) - 1)
    share = np.clip(times - early, 0, 1).reshape(-1, *[1] * (values.ndim - 1))
    return ((1 - share) * values[early] + share * values[late]).astype(values.dtype)

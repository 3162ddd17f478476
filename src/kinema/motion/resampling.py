"""Bring joints from one frame rate to another."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int


def resampled(values: Float[np.ndarray, "t *n"], fps: float, wanted: float) -> Float[np.ndarray, "m *n"]:
    """Read positions at t = 0, 1/wanted, 2/wanted, ..., linearly between frames; whole ratios pick frames as they are.

    Raises ValueError for a rate that isn't positive.
    """
    if not (0 < fps < np.inf and 0 < wanted < np.inf):
        raise ValueError(f"cannot resample from {fps:g} to {wanted:g} frames per second; rates are positive numbers")
    if fps == wanted or len(values) == 0:
        return values
    return blended(values, *sample_times(len(values), fps, wanted)).astype(values.dtype)


def sample_times(
    frames: int, fps: float, wanted: float
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Find for t = 0, 1/wanted, 2/wanted, ... the frames before and after, and the share of the one after."""
    count = int((frames - 1) / fps * wanted + 1e-6) + 1
    times = np.arange(count) * (fps / wanted)
    early = np.minimum(np.floor(times + 1e-9).astype(np.int64), frames - 1)
    return early, np.minimum(early + 1, frames - 1), np.clip(times - early, 0, 1)


def blended(
    values: Float[np.ndarray, "t *n"],
    early: Int[np.ndarray, " m"],
    late: Int[np.ndarray, " m"],
    share: Float[np.ndarray, " m"],
) -> Float[np.ndarray, "m *n"]:
    """Interpolate linearly between two frames each."""
    share = share.reshape(-1, *[1] * (values.ndim - 1))
    return (1 - share) * values[early] + share * values[late]

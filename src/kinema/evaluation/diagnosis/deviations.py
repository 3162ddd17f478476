"""Compare a column's own deviation with the one of its group, by which it is divided (HUMANML3D_DATA §6)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from kinema.motion.statistics import Statistics

CONSTANT = 1e-4
"""Of its group's deviation: a column that varies less is taken for constant, and has no ratio."""


def own_deviations(features: Float[np.ndarray, "n d"], rows: int = 65536) -> Float[np.ndarray, " d"]:
    """Return the population deviation of every column of a corpus, in float64, `rows` at a time."""
    starts = range(0, len(features), rows)
    mean = sum(np.asarray(features[i : i + rows], np.float64).sum(0) for i in starts) / len(features)
    squares = sum(np.square(np.asarray(features[i : i + rows], np.float64) - mean).sum(0) for i in starts)
    return np.sqrt(squares / len(features))


def phi(own: Float[np.ndarray, " d"], statistics: Statistics) -> Float[np.ndarray, " d"]:
    """Return the averaged over the own deviation, NaN where a column is constant.

    Divided by the averaged deviation, a column has the deviation 1 / phi instead of 1.
    """
    used = statistics.std[: len(own)]
    varies = own > CONSTANT * used
    return np.where(varies, used / np.where(varies, own, 1.0), np.nan)

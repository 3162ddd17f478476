"""Measure how far the distribution of each column is from a standard normal, or from that of other rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

QUANTILES = 1024


@dataclass(frozen=True)
class Marginals:
    """Hold each column's mean and deviation, and its distance from N(0, 1).

    `wasserstein` is the mean distance between quantiles (1-Wasserstein), `kolmogorov` the largest between distribution
    functions (Kolmogorov-Smirnov).
    """

    mean: Float[Tensor, " d"]
    std: Float[Tensor, " d"]
    wasserstein: Float[Tensor, " d"]
    kolmogorov: Float[Tensor, " d"]


def marginals(values: Float[Tensor, "n d"]) -> Marginals:
    """Measure every column; a sample of N(0, 1) itself is about 0.5 / sqrt(n) and 0.9 / sqrt(n) away."""
    ordered = values.double().sort(dim=0).values
    count = len(ordered)
    places = torch.arange(count, dtype=torch.float64, device=values.device)[:, None]
    normal = torch.special.ndtri((places + 0.5) / count)
    below = torch.special.ndtr(ordered)
    off = torch.maximum((below - places / count).abs(), (below - (places + 1) / count).abs())
    std = ordered.std(dim=0, correction=0)
    return Marginals(ordered.mean(0), std, (ordered - normal).abs().mean(0), off.amax(0))


def wasserstein(a: Float[np.ndarray, "n d"], b: Float[np.ndarray, "m d"]) -> Float[np.ndarray, " d"]:
    """Return the 1-Wasserstein distance of each column's two samples, over 1024 quantiles."""
    places = (np.arange(QUANTILES) + 0.5) / QUANTILES
    return np.abs(np.quantile(a, places, axis=0) - np.quantile(b, places, axis=0)).mean(0)

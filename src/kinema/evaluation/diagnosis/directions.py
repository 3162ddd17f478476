"""Measure, by the principal directions of clean rows, how much varies along each and how much noise is found there."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor


def principal(rows: Float[Tensor, "n c"]) -> tuple[Float[Tensor, " c"], Float[Tensor, "c c"]]:
    """Return the variances along the principal directions, the greatest first, and the directions as columns."""
    variances, directions = torch.linalg.eigh(torch.cov(rows.cpu().double().T))
    return variances.flip(0).clamp_min(0), directions.flip(1)


def bands(width: int) -> dict[str, slice]:
    """Split a number of directions into the first, the second, 3 to 4, 5 to 8 and so on, each band twice the last."""
    found, start, end = {}, 0, 1
    while start < width:
        end = min(end, width)
        found[f"{start + 1}" if end == start + 1 else f"{start + 1}-{end}"] = slice(start, end)
        start, end = end, 2 * end
    return found


def noise_found(
    noise: Float[Tensor, "n c"], error: Float[Tensor, "n c"], directions: Float[Tensor, "c c"]
) -> Float[Tensor, " c"]:
    """Return the share of the noise that a prediction of it finds, by direction: 1 + <error, noise> / <noise, noise>.

    `error` is the prediction's. 1: the noise is all found; 0: the prediction doesn't follow it.
    """
    noise, error = (values.cpu().double() @ directions for values in (noise, error))
    return 1 + (noise * error).mean(0) / noise.square().mean(0)

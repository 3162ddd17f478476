"""Find nearest neighbours among embeddings, in float64 and in parts, so that thousands of each fit."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from jaxtyping import Float, Int
from torch import Tensor

ROWS = 1024
"""Rows whose distances are held at once."""


def squared_distances(a: Float[Tensor, "n e"], b: Float[Tensor, "m e"]) -> Float[Tensor, "n m"]:
    """Return squared distances, at least 0; float64 keeps what |a|^2 + |b|^2 - 2ab cancels."""
    return (a.square().sum(1)[:, None] + b.square().sum(1) - 2 * a @ b.T).clamp_(min=0)


def in_parts(a: Float[Tensor, "n e"], b: Float[Tensor, "m e"]) -> Iterator[tuple[slice, Float[Tensor, "r m"]]]:
    """Yield the squared distances of some rows of `a` to all of `b`, and which rows they are."""
    for first in range(0, len(a), ROWS):
        rows = slice(first, first + ROWS)
        yield rows, squared_distances(a[rows], b)


def kth_distances(rows: Float[Tensor, "n e"], k: int) -> Float[Tensor, " n"]:
    """Return the squared distance of each row to its k-th nearest other row."""
    # The row itself is the nearest of all.
    return torch.cat([distances.kthvalue(k + 1, dim=1).values for _, distances in in_parts(rows, rows)])


def isolation(rows: Float[Tensor, "n e"], origins: Int[Tensor, "n 3"]) -> Float[Tensor, " n"]:
    """Return the distance of each row to the nearest row of other frames; infinity where there is none.

    `origins` hold each row's take by number and its frames there, the first and the one behind the last.
    """
    wide, (take, start, stop) = rows.to(torch.float64), origins.T
    found = []
    for part, distances in in_parts(wide, wide):
        same = (take[part, None] == take) & (start[part, None] < stop) & (start < stop[part, None])
        found.append(distances.masked_fill(same, torch.inf).min(1).values.sqrt())
    return torch.cat(found).to(rows.dtype)

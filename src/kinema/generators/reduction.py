"""Average losses over all ranks' rows, so that ranks together equal one process."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, distributed


def mean_rows(count: int, world: int, device: torch.device) -> Tensor:
    """Give the mean number of rows per rank; without a process group this rank's own."""
    rows = torch.tensor(float(count), device=device)
    if world > 1 and distributed.is_available() and distributed.is_initialized():
        distributed.all_reduce(rows)
        rows /= world
    return rows


def mean_over_ranks(rows: Float[Tensor, " m"], world: int) -> Float[Tensor, ""]:
    """Sum this rank's rows over the mean count per rank: averaged over ranks, the mean of all rows."""
    return rows.sum() / mean_rows(len(rows), world, rows.device).clamp(min=1 / world)

"""Share a batch's rows between ranks, so that a codebook learns the same on one process and on many."""

from __future__ import annotations

import torch
from jaxtyping import Shaped
from torch import Tensor, distributed


def together(world: int) -> bool:
    """Say whether the batch is shared between ranks that can talk (validation and plain calls: no)."""
    return world > 1 and distributed.is_available() and distributed.is_initialized()


def gather_rows(rows: Shaped[Tensor, "m *d"], world: int) -> Shaped[Tensor, "w *d"]:
    """Concatenate every rank's rows in rank order, without gradients; ranks may hold different numbers of rows."""
    if not together(world):
        return rows
    count = torch.tensor([len(rows)], device=rows.device)
    counts = [torch.empty_like(count) for _ in range(world)]
    distributed.all_gather(counts, count)
    sizes = [int(c) for c in counts]
    padded = rows.new_zeros(max(sizes), *rows.shape[1:])
    padded[: len(rows)] = rows
    parts = [torch.empty_like(padded) for _ in range(world)]
    distributed.all_gather(parts, padded)
    return torch.cat([part[:size] for part, size in zip(parts, sizes, strict=True)])


def largest(size: int, world: int, device: torch.device) -> int:
    """Give the largest of the ranks' sizes."""
    if not together(world):
        return size
    value = torch.tensor(size, device=device)
    distributed.all_reduce(value, op=distributed.ReduceOp.MAX)
    return int(value)

"""Share what ranks hold of one global batch, so that ranks together compute what one process would."""

from __future__ import annotations

from typing import Any

import torch
from jaxtyping import Float, Shaped
from torch import Tensor, distributed


def together(world: int) -> bool:
    """Say whether the batch is shared between ranks that can talk (validation and plain calls: no)."""
    return world > 1 and distributed.is_available() and distributed.is_initialized()


def mean_rows(count: int, world: int, device: torch.device) -> Tensor:
    """Return the mean number of rows per rank; without a process group this rank's own."""
    rows = torch.tensor(float(count), device=device)
    if together(world):
        distributed.all_reduce(rows)
        rows /= world
    return rows


def mean_over_ranks(rows: Float[Tensor, " m"], world: int) -> Float[Tensor, ""]:
    """Sum this rank's rows over the mean count per rank: averaged over ranks, the mean of all rows."""
    return rows.sum() / mean_rows(len(rows), world, rows.device).clamp(min=1 / world)


def largest(size: int, world: int, device: torch.device) -> int:
    """Return the largest of the ranks' sizes."""
    if not together(world):
        return size
    value = torch.tensor(size, device=device)
    distributed.all_reduce(value, op=distributed.ReduceOp.MAX)
    return int(value)


def gather_rows(rows: Shaped[Tensor, "m *d"], world: int) -> Shaped[Tensor, "w *d"]:
    """Concatenate every rank's rows in rank order, without gradients; ranks may hold different numbers of rows."""
    return torch.cat(_parts(rows, world)) if together(world) else rows


def gather(values: Shaped[Tensor, "b *d"], world: int) -> Shaped[Tensor, "w *d"]:
    """Concatenate every rank's rows in rank order; gradients flow back to the rank they belong to.

    `world` is the number of ranks that share the batch: 1 where each has all of it (validation). Every rank then
    computes the same loss: a parameter's gradient, averaged by DDP, is that of one process with the whole batch.
    """
    return values if world == 1 else _Gather.apply(values, world)


class _Gather(torch.autograd.Function):
    """Gather rows forwards; sum the ranks' gradients and keep the own rows backwards."""

    @staticmethod
    def forward(ctx: Any, values: Tensor, world: int) -> Tensor:
        parts = _parts(values, world)
        ctx.first = sum(len(part) for part in parts[: distributed.get_rank()])
        ctx.size = len(values)
        return torch.cat(parts)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:
        total = gradient.contiguous().clone()
        distributed.all_reduce(total)
        return total[ctx.first : ctx.first + ctx.size], None


def _parts(rows: Shaped[Tensor, "m *d"], world: int) -> list[Shaped[Tensor, "n *d"]]:
    """Fetch every rank's rows; those of the shorter ones travel padded."""
    count = torch.tensor([len(rows)], device=rows.device)
    counts = [torch.empty_like(count) for _ in range(world)]
    distributed.all_gather(counts, count)
    sizes = [int(c) for c in counts]
    padded = rows.new_zeros(max(sizes), *rows.shape[1:])
    padded[: len(rows)] = rows
    parts = [torch.empty_like(padded) for _ in range(world)]
    distributed.all_gather(parts, padded)
    return [part[:size] for part, size in zip(parts, sizes, strict=True)]

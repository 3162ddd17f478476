"""Gather a batch's embeddings across ranks, so that a contrastive loss sees the same batch on one process or many."""

from __future__ import annotations

from typing import Any

import torch
import torch.distributed as dist
from jaxtyping import Shaped
from torch import Tensor


def gather(values: Shaped[Tensor, "b *d"], world: int) -> Shaped[Tensor, "w *d"]:
    """Concatenate every rank's rows in rank order; gradients flow back to the rank they belong to.

    `world` is the number of ranks that share the batch: 1 where each has all of it (validation).

    Ranks may hold different numbers of rows. Every rank then computes the same loss, so the gradient of a parameter,
    averaged by DDP, is that of one process with the whole batch.
    """
    if world == 1:
        return values
    return _Gather.apply(values)


class _Gather(torch.autograd.Function):
    """Gather rows forwards; sum the ranks' gradients and keep the own rows backwards."""

    @staticmethod
    def forward(ctx: Any, values: Tensor) -> Tensor:
        world, rank = dist.get_world_size(), dist.get_rank()
        count = torch.tensor([len(values)], device=values.device)
        counts = [torch.empty_like(count) for _ in range(world)]
        dist.all_gather(counts, count)
        sizes = [int(c) for c in counts]
        padded = values.new_zeros(max(sizes), *values.shape[1:])
        padded[: len(values)] = values
        parts = [torch.empty_like(padded) for _ in range(world)]
        dist.all_gather(parts, padded)
        ctx.first, ctx.size = sum(sizes[:rank]), len(values)
        return torch.cat([part[:size] for part, size in zip(parts, sizes, strict=True)])

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> Tensor:
        total = gradient.contiguous().clone()
        dist.all_reduce(total)
        return total[ctx.first : ctx.first + ctx.size]

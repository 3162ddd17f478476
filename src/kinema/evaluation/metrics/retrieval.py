"""Find a caption's own motion among 32: R-precision and matching score (METRICS, Definitions)."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torchmetrics import Metric

from kinema.data.sampler import LEFTOVERS
from kinema.evaluation.metrics.finite import require_finite

TOP = 3


class Retrieval(Metric):
    """Count hits among the k nearest motions of each caption, in consecutive pools within every update.

    The rows of an update beyond a whole number of pools are left out ("drop", "mld") or form a smaller, easier pool
    ("keep"). `compute` gives r1, r2, r3 and matching (the mean distance of a caption to its own motion).
    """

    is_differentiable, full_state_update = False, False
    hits: Int[Tensor, " k"]
    distance: Tensor
    count: Tensor

    def __init__(self, pool: int = 32, leftover: str = "drop", **kwargs: object) -> None:
        super().__init__(**kwargs)
        if leftover not in LEFTOVERS:
            raise ValueError(f"leftover={leftover!r}; allowed: {', '.join(LEFTOVERS)}")
        self.pool, self.leftover = pool, leftover
        self.add_state("hits", torch.zeros(TOP, dtype=torch.int64), dist_reduce_fx="sum")
        self.add_state("distance", torch.zeros((), dtype=torch.float32), dist_reduce_fx="sum")
        self.add_state("count", torch.zeros((), dtype=torch.int64), dist_reduce_fx="sum")

    def update(
        self, text: Float[Tensor, "b e"], motion: Float[Tensor, "b e"], keep: Bool[Tensor, " b"] | None = None
    ) -> None:
        """Add pairs; with `keep` only its rows are counted, still against their whole pool."""
        require_finite(text, "text embeddings")
        require_finite(motion, "motion embeddings")
        ranks, distances = pool_ranks(text, motion, self.pool, keep_rest=self.leftover == "keep")
        if keep is not None:
            chosen = keep[: len(ranks)].to(ranks.device)
            ranks, distances = ranks[chosen], distances[chosen]
        ranks, distances = ranks.to(self.hits.device), distances.to(self.hits.device)
        self.hits += hits_at(ranks)
        self.distance += distances.sum()
        self.count += len(ranks)

    def compute(self) -> dict[str, Tensor]:
        """Return r1, r2, r3 and matching; nothing if no pool was full."""
        if self.count == 0:
            return {}
        precision = {f"r{k + 1}": self.hits[k] / self.count for k in range(TOP)}
        return precision | {"matching": self.distance / self.count}


def hits_at(ranks: Int[Tensor, " n"]) -> Int[Tensor, " k"]:
    """Count the ranks (from 0) that are among the first 1, 2 and 3."""
    return (ranks[:, None] <= torch.arange(TOP, device=ranks.device)).sum(0)


def pool_ranks(
    text: Float[Tensor, "b e"], motion: Float[Tensor, "b e"], pool: int, *, keep_rest: bool = False
) -> tuple[Int[Tensor, " n"], Float[Tensor, " n"]]:
    """Return for every caption the rank (from 0) of its own motion in its pool, and the distance to it.

    Of equal distances the lower index comes first, as in a stable sort. Differences are taken before squaring, so
    equal rows have equal distances and none is the root of a negative number.
    """
    ranks, distances = [torch.zeros(0, dtype=torch.int64, device=text.device)], [text.new_zeros(0)]
    end = len(text) if keep_rest else len(text) - len(text) % pool
    for start in range(0, end, pool):
        rows = slice(start, min(start + pool, end))
        matrix = torch.cdist(text[rows], motion[rows], compute_mode="donot_use_mm_for_euclid_dist")
        own = matrix.diagonal()[:, None]
        index = torch.arange(len(matrix), device=matrix.device)
        tied_before = (matrix == own) & (index[None, :] < index[:, None])
        ranks.append(((matrix < own) | tied_before).sum(1))
        distances.append(own[:, 0])
    return torch.cat(ranks), torch.cat(distances)

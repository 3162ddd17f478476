"""Hold R-precision against real motion's own, in the same pools: above 1 the judge can no longer rank."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torchmetrics import Metric

from kinema.evaluation.metrics.finite import require_finite
from kinema.evaluation.metrics.retrieval import TOP, hits_at, pool_ranks


class RetrievalShare(Metric):
    """Divide the R-precision of motions by that of the real motions of the same captions and pools.

    Real motion is no upper bound of R-precision (METRICS, Pitfalls 7): a model can answer captions more literally than
    people did. `pool` and `leftover` are `Retrieval`'s.
    """

    is_differentiable, higher_is_better, full_state_update = False, True, False
    hits: Int[Tensor, " k"]
    real_hits: Int[Tensor, " k"]

    def __init__(self, pool: int = 32, leftover: str = "drop", **kwargs: object) -> None:
        super().__init__(**kwargs)
        self.pool, self.leftover = pool, leftover
        for name in ("hits", "real_hits"):
            self.add_state(name, torch.zeros(TOP, dtype=torch.int64), dist_reduce_fx="sum")

    def update(self, text: Float[Tensor, "b e"], motion: Float[Tensor, "b e"], real: Float[Tensor, "b e"]) -> None:
        """Add captions, the motions that answer them and the real ones."""
        self.hits += self._hits(text, motion)
        self.real_hits += self._hits(text, real)

    def compute(self) -> dict[str, Tensor]:
        """Return r1_of_real, r2_of_real and r3_of_real; one that real motion has no hit of is left out."""
        return {f"r{k + 1}_of_real": self.hits[k] / self.real_hits[k] for k in range(TOP) if self.real_hits[k] > 0}

    def _hits(self, text: Tensor, motion: Tensor) -> Int[Tensor, " k"]:
        require_finite(motion, "motion embeddings")
        ranks, _ = pool_ranks(text, motion, self.pool, keep_rest=self.leftover == "keep")
        return hits_at(ranks).to(self.device)

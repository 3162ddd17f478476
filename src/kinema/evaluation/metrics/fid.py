"""Compare two sets of embeddings as Gaussians: FID (METRICS, Definitions)."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor
from torchmetrics import Metric

from kinema.evaluation.metrics.finite import require_finite


class FrechetDistance(Metric):
    """Accumulate sums and outer products of real and generated embeddings in float64.

    Covariances are unbiased (n - 1), as np.cov's. On devices without float64 the states stay on the CPU.
    """

    is_differentiable, higher_is_better, full_state_update = False, False, False
    real_sum: Tensor

    def __init__(self, width: int, **kwargs: object) -> None:
        super().__init__(**kwargs)
        for side in ("real", "generated"):
            self.add_state(f"{side}_count", torch.zeros((), dtype=torch.float64), dist_reduce_fx="sum")
            self.add_state(f"{side}_sum", torch.zeros(width, dtype=torch.float64), dist_reduce_fx="sum")
            self.add_state(f"{side}_outer", torch.zeros(width, width, dtype=torch.float64), dist_reduce_fx="sum")

    def update(self, real: Float[Tensor, "b e"], generated: Float[Tensor, "n e"]) -> None:
        """Add embeddings of real and generated motions; their numbers may differ."""
        for side, embeddings in (("real", real), ("generated", generated)):
            require_finite(embeddings, f"{side} motion embeddings")
            # Moved first, widened then: some devices have no float64.
            rows = embeddings.detach().to(self.real_sum.device).to(torch.float64)
            setattr(self, f"{side}_count", getattr(self, f"{side}_count") + len(rows))
            setattr(self, f"{side}_sum", getattr(self, f"{side}_sum") + rows.sum(0))
            setattr(self, f"{side}_outer", getattr(self, f"{side}_outer") + rows.T @ rows)

    def compute(self) -> Float[Tensor, ""]:
        """Return the distance; ValueError with fewer than two samples on a side."""
        moments = []
        for side in ("real", "generated"):
            count = getattr(self, f"{side}_count").cpu()
            if count < 2:
                raise ValueError(f"FID needs at least 2 {side} motions, got {int(count)}; evaluate more clips")
            mean = getattr(self, f"{side}_sum").cpu() / count
            outer = getattr(self, f"{side}_outer").cpu()
            moments.append((mean, (outer - count * torch.outer(mean, mean)) / (count - 1)))
        return frechet_distance(*moments[0], *moments[1])


def frechet_distance(
    mean_a: Float[Tensor, " e"], cov_a: Float[Tensor, "e e"], mean_b: Float[Tensor, " e"], cov_b: Float[Tensor, "e e"]
) -> Float[Tensor, ""]:
    """Return |mean_a - mean_b|^2 + tr(A) + tr(B) - 2 tr((A B)^(1/2)), at least 0.

    The last trace is the sum of the square roots of the eigenvalues of A^(1/2) B A^(1/2), which is symmetric: no
    complex or non-finite square root as with a general one.
    """
    root = _matrix_root(cov_a)
    inner = root @ cov_b @ root
    cross = torch.linalg.eigvalsh((inner + inner.T) / 2).clamp(min=0).sqrt().sum()
    distance = (mean_a - mean_b).square().sum() + cov_a.trace() + cov_b.trace() - 2 * cross
    return distance.clamp(min=0)


def _matrix_root(matrix: Float[Tensor, "e e"]) -> Float[Tensor, "e e"]:
    values, vectors = torch.linalg.eigh((matrix + matrix.T) / 2)
    return (vectors * values.clamp(min=0).sqrt()) @ vectors.T

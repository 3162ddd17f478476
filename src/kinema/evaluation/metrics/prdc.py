"""Tell fidelity from variety: precision, recall, density and coverage of two sets of embeddings."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor
from torchmetrics import Metric
from torchmetrics.utilities import dim_zero_cat

from kinema.evaluation.metrics.finite import require_finite
from kinema.evaluation.metrics.neighbours import in_parts, kth_distances


class PRDC(Metric):
    """Count who lies within whose k-th nearest neighbour, real and generated motion against each other.

    precision: share of generated motions within the ball of any real one (its radius is the distance to its k-th
    nearest other real one); recall: the other way round (Kynkäänniemi et al. 2019). density: real balls that a
    generated motion lies in, over k; coverage: share of real balls with a generated motion in them (Naeem et al.
    2020). Balls are open, so that a set has density 1 in itself.
    """

    is_differentiable, full_state_update = False, False
    real: list[Tensor]
    generated: list[Tensor]

    def __init__(self, k: int = 5, **kwargs: object) -> None:
        super().__init__(**kwargs)
        if k < 1:
            raise ValueError(f"k={k}; it must be at least 1")
        self.k = k
        for name in ("real", "generated"):
            self.add_state(name, [], dist_reduce_fx="cat")

    def update(self, real: Float[Tensor, "b e"], generated: Float[Tensor, "n e"]) -> None:
        """Add embeddings of real and generated motions; their numbers may differ."""
        require_finite(real, "real motion embeddings")
        require_finite(generated, "generated motion embeddings")
        self.real.append(real.detach().to(self.device))
        self.generated.append(generated.detach().to(self.device))

    def compute(self) -> dict[str, Tensor]:
        """Return precision, recall, density and coverage; nothing where a side has no k-th nearest other motion."""
        real, generated = (dim_zero_cat(rows).to(torch.float64) for rows in (self.real, self.generated))
        if min(len(real), len(generated)) <= self.k:
            return {}
        real_radii, generated_radii = kth_distances(real, self.k), kth_distances(generated, self.k)
        precise = torch.zeros(len(generated), dtype=torch.bool, device=real.device)
        recalled, balls, covered = [], [], []
        for rows, distances in in_parts(real, generated):
            inside = distances < real_radii[rows, None]
            precise |= inside.any(0)
            balls.append(inside.sum(1))
            covered.append(inside.any(1))
            recalled.append((distances < generated_radii).any(1))
        return {
            "precision": precise.double().mean(),
            "recall": torch.cat(recalled).double().mean(),
            "density": torch.cat(balls).sum().double() / (self.k * len(generated)),
            "coverage": torch.cat(covered).double().mean(),
        }

"""Measure how far generated motion is from what was trained on, and how much of it is memorised."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor
from torchmetrics import Metric

from kinema.evaluation.metrics.finite import require_finite


class NearestTraining(Metric):
    """Look up every motion's nearest training motion by the distance of embeddings.

    nearest_train: mean distance to it. memorised: share of the motions that are at least as near to it as it is to its
    own nearest other training motion, 1 - authenticity (Alaa et al. 2022, "How faithful is your synthetic data?").
    `isolation` holds that distance for every training motion; its mirror image and others of the same frames must not
    count as other (`TrainingSet`).
    """

    is_differentiable, full_state_update = False, False
    embeddings: Float[Tensor, "n e"]
    squares: Float[Tensor, " n"]
    isolation: Float[Tensor, " n"]
    distance: Tensor
    copies: Tensor
    count: Tensor

    def __init__(self, embeddings: Float[Tensor, "n e"], isolation: Float[Tensor, " n"], **kwargs: object) -> None:
        super().__init__(**kwargs)
        wide = embeddings.to(torch.float64)
        self.register_buffer("embeddings", wide, persistent=False)
        self.register_buffer("squares", wide.square().sum(1), persistent=False)
        self.register_buffer("isolation", isolation, persistent=False)
        self.add_state("distance", torch.zeros((), dtype=torch.float64), dist_reduce_fx="sum")
        for name in ("copies", "count"):
            self.add_state(name, torch.zeros((), dtype=torch.int64), dist_reduce_fx="sum")

    def update(self, motion: Float[Tensor, "b e"]) -> None:
        """Add embeddings of generated motions."""
        require_finite(motion, "generated motion embeddings")
        rows = motion.detach().to(self.embeddings.device).to(torch.float64)
        nearest = (self.squares - 2 * rows @ self.embeddings.T).argmin(1)
        # From the difference: a copy has distance 0.
        distances = (rows - self.embeddings[nearest]).norm(dim=1)
        self.distance += distances.sum()
        self.copies += (distances <= self.isolation[nearest]).sum()
        self.count += len(rows)

    def compute(self) -> dict[str, Tensor]:
        """Return nearest_train and memorised."""
        return {"nearest_train": self.distance / self.count, "memorised": self.copies / self.count}

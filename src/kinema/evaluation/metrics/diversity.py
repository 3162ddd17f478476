"""Measure how much motions differ: over all captions (diversity) and for one caption (MultiModality)."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torchmetrics import Metric
from torchmetrics.utilities import dim_zero_cat

from kinema.evaluation.metrics.finite import require_finite

FEW_PAIRS = 100


class Diversity(Metric):
    """Average the distances of random pairs of embeddings (METRICS, Definitions).

    Both draws are without replacement, and of `pairs` rows if there are more rows than that, else of 100 (MARDM §8),
    else of all rows but one. `index` (each row's place in the replication) makes the draw independent of the order
    and the process in which rows arrive.
    """

    is_differentiable, higher_is_better, full_state_update = False, True, False
    embeddings: list[Tensor]
    places: list[Tensor]

    def __init__(self, pairs: int = 300, seed: int = 0, **kwargs: object) -> None:
        super().__init__(**kwargs)
        self.pairs, self.seed = pairs, seed
        self.add_state("embeddings", [], dist_reduce_fx="cat")
        self.add_state("places", [], dist_reduce_fx="cat")

    def update(self, embeddings: Float[Tensor, "b e"], index: Int[Tensor, " b"]) -> None:
        """Add embeddings of generated motions."""
        require_finite(embeddings, "generated motion embeddings")
        self.embeddings.append(embeddings.detach().to(self.device))
        self.places.append(index.to(self.device))

    def compute(self) -> Float[Tensor, ""]:
        """Return the diversity; ValueError with fewer than two motions."""
        # Synchronising ranks has made one tensor of each list.
        embeddings = dim_zero_cat(self.embeddings)[torch.argsort(dim_zero_cat(self.places))]
        first, second = draw_pairs(len(embeddings), self.pairs, self.seed)
        return mean_distance(embeddings, first.to(embeddings.device), second.to(embeddings.device))


class MultiModality(Metric):
    """Average the distances of random pairs of generations for one caption; the same pairs for every caption."""

    is_differentiable, higher_is_better, full_state_update = False, True, False
    distance: Tensor
    texts: Tensor

    def __init__(self, pairs: int = 10, seed: int = 0, **kwargs: object) -> None:
        super().__init__(**kwargs)
        self.pairs, self.seed = pairs, seed
        self.add_state("distance", torch.zeros(()), dist_reduce_fx="sum")
        self.add_state("texts", torch.zeros((), dtype=torch.int64), dist_reduce_fx="sum")

    def update(self, embeddings: Float[Tensor, "b r e"]) -> None:
        """Add all generations of some captions, at least 2 of each; `pairs` is at most one less than them."""
        require_finite(embeddings, "repeated generations' embeddings")
        repeats = embeddings.shape[1]
        if repeats < 2:
            raise ValueError(
                f"MultiModality needs at least 2 generations of a caption, got {repeats}; raise mm_repeats"
            )
        first, second = (i.to(embeddings.device) for i in draw_pairs(repeats, self.pairs, self.seed))
        distances = (embeddings[:, first] - embeddings[:, second]).norm(dim=-1)
        self.distance += distances.mean(1).sum().to(self.device)
        self.texts += len(embeddings)

    def compute(self) -> Float[Tensor, ""]:
        """Return the mean over captions and pairs."""
        if self.texts == 0:
            raise ValueError("MultiModality has seen no captions; set mm_texts to at least 1")
        return self.distance / self.texts


def draw_pairs(count: int, pairs: int, seed: int) -> tuple[Int[Tensor, " p"], Int[Tensor, " p"]]:
    """Draw twice without replacement; fewer pairs where there are too few rows."""
    if count < 2:
        raise ValueError(f"diversity needs at least 2 motions, got {count}; evaluate more clips")
    if count <= pairs:
        pairs = FEW_PAIRS if count > FEW_PAIRS else count - 1
    random = np.random.default_rng(seed)
    first, second = (torch.from_numpy(random.choice(count, pairs, replace=False)) for _ in range(2))
    return first, second


def mean_distance(
    embeddings: Float[Tensor, "n *e"], first: Int[Tensor, " p"], second: Int[Tensor, " p"]
) -> Float[Tensor, ""]:
    """Average the distances of given pairs."""
    return (embeddings[first] - embeddings[second]).norm(dim=-1).mean()

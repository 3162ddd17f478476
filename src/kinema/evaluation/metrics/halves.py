"""Hold FID and the FID of a perfect sampler of the same size side by side: halves of one replication."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torchmetrics import Metric
from torchmetrics.utilities import dim_zero_cat

from kinema.evaluation.metrics.fid import FrechetDistance
from kinema.evaluation.metrics.finite import require_finite

LEAST = 4
"""Rows that leave two in each half: a covariance needs them."""


class HalvesDistance(Metric):
    """Give the FID of motions of half of the captions to real ones of the other half, and of real to real motion.

    Both are of equally many samples, so that FID's bias of small samples (METRICS, Pitfalls 6) is in both: a method
    whose fid_halves is real_fid_halves can't be told from real motion by FID. `index` (each row's place in the
    replication) makes the halves independent of the order in which rows arrive.
    """

    is_differentiable, higher_is_better, full_state_update = False, False, False
    real: list[Tensor]
    generated: list[Tensor]
    places: list[Tensor]

    def __init__(self, seed: int = 0, **kwargs: object) -> None:
        super().__init__(**kwargs)
        self.seed = seed
        for name in ("real", "generated", "places"):
            self.add_state(name, [], dist_reduce_fx="cat")

    def update(self, real: Float[Tensor, "b e"], generated: Float[Tensor, "b e"], index: Int[Tensor, " b"]) -> None:
        """Add embeddings; row i of both answers the same caption."""
        require_finite(real, "real motion embeddings")
        require_finite(generated, "generated motion embeddings")
        self.real.append(real.detach().to(self.device))
        self.generated.append(generated.detach().to(self.device))
        self.places.append(index.to(self.device))

    def compute(self) -> dict[str, Tensor]:
        """Return fid_halves and real_fid_halves; nothing of fewer than four rows."""
        order = torch.argsort(dim_zero_cat(self.places))
        if len(order) < LEAST:
            return {}
        # On the CPU wherever the rows are, so that real motion's value is the same for every source.
        real, generated = (dim_zero_cat(rows)[order].cpu() for rows in (self.real, self.generated))
        return {
            "fid_halves": halves_distance(generated, real, self.seed),
            "real_fid_halves": halves_distance(real, real, self.seed),
        }


def halves_distance(first: Float[Tensor, "n e"], second: Float[Tensor, "n e"], seed: int) -> Float[Tensor, ""]:
    """Return the FID of one random half of the rows of `first` to the other half of the rows of `second`."""
    order = torch.from_numpy(np.random.default_rng(seed).permutation(len(first))).to(first.device)
    half = len(first) // 2
    metric = FrechetDistance(first.shape[1], sync_on_compute=False)
    metric.update(first[order[:half]], second[order[half : 2 * half]])
    return metric.compute()

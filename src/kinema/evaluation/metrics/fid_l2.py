"""Compare directions of embeddings alone: FID on the unit sphere."""

from __future__ import annotations

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from kinema.evaluation.metrics.fid import FrechetDistance


class UnitFrechetDistance(FrechetDistance):
    """Compute FID on embeddings of length 1.

    An evaluator's embeddings have no scale of their own, and few long ones dominate means and covariances; on the
    sphere every motion weighs the same and values lie in [0, 4], whatever the evaluator.
    """

    def update(self, real: Float[Tensor, "b e"], generated: Float[Tensor, "n e"]) -> None:
        """Add embeddings of any length; their numbers may differ."""
        super().update(F.normalize(real, dim=-1), F.normalize(generated, dim=-1))

"""Average the cosine of motion and caption embeddings: CLIP-score (CLIP_EVALUATOR §4)."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor
from torchmetrics import Metric

from kinema.evaluation.metrics.finite import require_finite


class ClipScore(Metric):
    """Average cos(motion_i, text_i); no clipping at 0, no factor 2.5."""

    is_differentiable, higher_is_better, full_state_update = False, True, False
    total: Tensor
    count: Tensor

    def __init__(self, **kwargs: object) -> None:
        super().__init__(**kwargs)
        self.add_state("total", torch.zeros(()), dist_reduce_fx="sum")
        self.add_state("count", torch.zeros((), dtype=torch.int64), dist_reduce_fx="sum")

    def update(self, motion: Float[Tensor, "b e"], text: Float[Tensor, "b e"]) -> None:
        """Add pairs of embeddings of the contrastive evaluator (normalised here if they are not)."""
        require_finite(motion, "motion embeddings of the CLIP-style evaluator")
        require_finite(text, "text embeddings of the CLIP-style evaluator")
        self.total += F.cosine_similarity(motion, text, dim=-1).sum().to(self.device)
        self.count += len(motion)

    def compute(self) -> Float[Tensor, ""]:
        """Return the mean."""
        return self.total / self.count

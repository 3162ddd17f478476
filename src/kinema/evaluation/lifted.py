"""Show motion of essential dims to a judge of all dims, its redundant ones recomputed (MARDM Table 4)."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Bool, Int
from torch import Tensor

from kinema.evaluation.sources import Source, answer
from kinema.motion.lifting import lift
from kinema.motion.skeleton import Skeleton
from kinema.types import MotionBatch


class Lifted(Source):
    """Answer as another source does, with redundant columns that follow from its joints.

    All redundant columns are replaced, those of captured motion and of methods that make their own too: what that
    changes on real motion is what lifting costs.
    """

    def __init__(self, source: Source, skeleton: Skeleton) -> None:
        self.source, self.skeleton = source, skeleton
        self.label, self.multimodal, self.reconstructs = (
            f"{source.label}, lifted",
            source.multimodal,
            source.reconstructs,
        )
        self.text_encoder, self.dims = source.text_encoder, source.dims

    def __call__(self, batch: MotionBatch, seeds: Int[Tensor, " b"]) -> MotionBatch:
        """Lift every answer."""
        made = self.source(batch, seeds)
        rows = made.features.float().cpu().numpy()
        full = np.zeros((*rows.shape[:2], self.skeleton.feature_width), dtype=np.float32)
        for row, motion, length in zip(full, rows, made.lengths.tolist(), strict=True):
            row[:length] = lift(motion[:length], self.skeleton)
        return answer(made, torch.from_numpy(full).to(made.features.device), made.lengths)

    def measured(self) -> dict[str, float]:
        """Return what the source measured."""
        return self.source.measured()

    def kept(self, lengths: Int[Tensor, " b"]) -> Bool[Tensor, "b t"] | None:
        """Mark the frames that the source keeps."""
        return self.source.kept(lengths)

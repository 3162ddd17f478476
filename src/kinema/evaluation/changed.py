"""Change motions before they are judged: their redundant dims recomputed (MARDM Table 4), or their feet held."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from kinema.evaluation.source import Source, Together, answer, answers
from kinema.evaluation.together import Asked
from kinema.motion.cleaning import lock_rows
from kinema.motion.lifting import lift
from kinema.motion.skeleton import Skeleton
from kinema.types import MotionBatch


class Changed(Together):
    """Answer as another source does, each motion's rows changed; captured motion's too.

    What that changes on real motion is what the change costs by itself.
    """

    how: str

    def __init__(self, source: Source, skeleton: Skeleton) -> None:
        self.source, self.skeleton = source, skeleton
        self.label, self.multimodal, self.reconstructs = (
            f"{source.label}, {self.how}",
            source.multimodal,
            source.reconstructs,
        )
        self.text_encoder, self.dims = source.text_encoder, source.dims

    @abstractmethod
    def change(self, rows: Float[np.ndarray, "t w"]) -> Float[np.ndarray, "t d"]:
        """Return the changed rows of one motion."""

    def answer_all(self, questions: Sequence[Asked]) -> list[MotionBatch]:
        """Change every answer."""
        return [self._changed(made) for made in answers(self.source, questions)]

    def _changed(self, made: MotionBatch) -> MotionBatch:
        rows = made.features.float().cpu().numpy()
        changed = [self.change(motion[:length]) for motion, length in zip(rows, made.lengths.tolist(), strict=True)]
        full = np.zeros((*rows.shape[:2], changed[0].shape[1]), dtype=np.float32)
        for row, motion in zip(full, changed, strict=True):
            row[: len(motion)] = motion
        return answer(made, torch.from_numpy(full).to(made.features.device), made.lengths)

    def measured(self) -> dict[str, float]:
        """Return what the source measured."""
        return self.source.measured()

    def seconds(self) -> float | None:
        """Return how long a motion took the source; the change is left out."""
        return self.source.seconds()

    def kept(self, lengths: Int[Tensor, " b"]) -> Bool[Tensor, "b t"] | None:
        """Mark the frames that the source keeps."""
        return self.source.kept(lengths)


class Lifted(Changed):
    """Show motion of essential dims to a judge of all: its redundant columns follow from its joints.

    All redundant columns are replaced, those of methods that make their own too.
    """

    how = "lifted"

    def change(self, rows: Float[np.ndarray, "t w"]) -> Float[np.ndarray, "t d"]:
        """Lift one motion."""
        return lift(rows, self.skeleton)


class FeetLocked(Changed):
    """Hold feet where they stand, as `kinema export --lock-feet` does."""

    how = "feet held"

    def change(self, rows: Float[np.ndarray, "t w"]) -> Float[np.ndarray, "t w"]:
        """Clean one motion."""
        return lock_rows(rows, self.skeleton)

"""Say what a source of motion is: it answers the captions of a batch, or of several at once."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace

from jaxtyping import Bool, Float, Int
from torch import Tensor

from kinema.evaluation.together import Asked
from kinema.text.frozen import FrozenTextEncoder
from kinema.types import MotionBatch


class Source(ABC):
    """Answer the captions of a batch with motions, in the same order.

    `seeds` hold one seed per row, and a row's answer depends on its own seed only. `multimodal`: other seeds give
    other motions. `reconstructs`: row i is meant to equal row i of the batch, frame by frame. `text_encoder` is what
    reads the captions (None: nothing does), `dims` the columns of the batch that it reads.
    """

    label: str
    multimodal: bool = False
    reconstructs: bool = False
    text_encoder: FrozenTextEncoder | None = None
    dims: str = "essential"

    @abstractmethod
    def __call__(self, batch: MotionBatch, seeds: Int[Tensor, " b"]) -> MotionBatch:
        """Return the motions."""

    def measured(self) -> dict[str, float]:
        """Return what the source measured of itself since the last call, by the names of metrics."""
        return {}

    def seconds(self) -> float | None:
        """Return how long a motion took to make since the last call, by the clock; None: none is made.

        Apart from what is `measured`, which no machine changes.
        """
        return None

    def kept(self, lengths: Int[Tensor, " b"]) -> Bool[Tensor, "b t"] | None:
        """Mark the frames of answers to clips of these lengths that are the clips' own; None: the source edits none."""
        return None


class Together(Source):
    """Answer several batches at once; the answers are those to each by itself, but for rounding."""

    @abstractmethod
    def answer_all(self, questions: Sequence[Asked]) -> list[MotionBatch]:
        """Return the motions, batch by batch."""

    def __call__(self, batch: MotionBatch, seeds: Int[Tensor, " b"]) -> MotionBatch:
        """Return the motions of one batch."""
        (made,) = self.answer_all([(batch, seeds)])
        return made


def answers(source: Source, asked: Sequence[Asked]) -> list[MotionBatch]:
    """Ask a source several batches, at once if it can be."""
    if isinstance(source, Together):
        return source.answer_all(asked)
    return [source(batch, seeds) for batch, seeds in asked]


def answer(prompt: MotionBatch, features: Float[Tensor, "b t w"], lengths: Int[Tensor, " b"]) -> MotionBatch:
    """Put motions in the place of a batch's; captions and names stay."""
    return replace(prompt, features=features, lengths=lengths)

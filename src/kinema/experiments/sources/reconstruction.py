"""Score what a tokenizer makes of real motion."""

from __future__ import annotations

from typing import TYPE_CHECKING

from kinema.experiments.sources.base import ScoredSource
from kinema.experiments.stages.tokenizer import TokenizerStage

if TYPE_CHECKING:
    from kinema.evaluation.source import Source
    from kinema.experiments.evaluation import Row
    from kinema.experiments.scoring import Scorer


class ReconstructionSource(ScoredSource):
    """Encode and decode the test clips."""

    name = "reconstruction"
    scores = TokenizerStage.name

    def open(self, scorer: Scorer, row: Row) -> Source:
        """Make what answers."""
        from kinema.evaluation.sources import Reconstruction
        from kinema.experiments.instantiate import read_model

        ((part, run),) = row.subject.items()
        return Reconstruction(read_model(run, part).to(scorer.device))

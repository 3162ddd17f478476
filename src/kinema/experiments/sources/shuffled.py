"""Score real motion under captions of other clips."""

from __future__ import annotations

from typing import TYPE_CHECKING

from kinema.experiments.sources.base import ScoredSource

if TYPE_CHECKING:
    from kinema.evaluation.source import Source
    from kinema.experiments.evaluation import Row
    from kinema.experiments.scoring import Scorer


class ShuffledSource(ScoredSource):
    """Deal the test clips out anew."""

    name = "shuffled"

    def open(self, scorer: Scorer, row: Row) -> Source:
        """Make what answers."""
        from kinema.evaluation.sources import ShuffledCaptions

        return ShuffledCaptions()

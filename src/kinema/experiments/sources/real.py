"""Score captured motion itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

from kinema.experiments.sources.base import ScoredSource

if TYPE_CHECKING:
    from kinema.evaluation.source import Source
    from kinema.experiments.evaluation import Row
    from kinema.experiments.scoring import Scorer


class RealSource(ScoredSource):
    """Show the test clips."""

    name = "real"

    def open(self, scorer: Scorer, row: Row) -> Source:
        """Make what answers."""
        from kinema.evaluation.sources import RealMotion

        return RealMotion()

    def completed(self, metrics: dict[str, float]) -> dict[str, float]:
        """Return half against half under its name in results of before, too."""
        return {"half_fid": metrics["real_fid_halves"]} if "real_fid_halves" in metrics else {}

"""Score real motion some of whose dims are altered (MARDM Table 3)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from omegaconf import DictConfig

from kinema.experiments.sources.base import ScoredSource

if TYPE_CHECKING:
    from kinema.evaluation.source import Source
    from kinema.experiments.evaluation import Row
    from kinema.experiments.scoring import Scorer


class PerturbedSource(ScoredSource):
    """Alter the test clips as `perturb` says."""

    name = "perturbed"
    groups = ("perturb",)

    def label(self, cfg: DictConfig) -> str:
        """Name what is done to which dims."""
        return f"{self.name}_{cfg.perturb.how}_{cfg.perturb.dims}"

    def open(self, scorer: Scorer, row: Row) -> Source:
        """Make what answers; deviations are the judge's or the corpus'."""
        from kinema.evaluation.perturbed import Perturbed, judged

        perturb, statistics = scorer.cfg.perturb, scorer.store.statistics
        if perturb.space == "evaluator":
            statistics = judged(scorer.matching.representation, statistics)
        return Perturbed(scorer.store.skeleton, statistics, altered=perturb.dims, how=perturb.how, level=perturb.level)

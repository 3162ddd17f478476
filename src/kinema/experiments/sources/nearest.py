"""Score the training clip of the nearest caption."""

from __future__ import annotations

from typing import TYPE_CHECKING

from omegaconf import DictConfig

from kinema.experiments.sources.base import ScoredSource

if TYPE_CHECKING:
    from kinema.evaluation.source import Source
    from kinema.experiments.evaluation import Row
    from kinema.experiments.scoring import Scorer


class NearestSource(ScoredSource):
    """Look prompts up among the training captions."""

    name = "nearest"

    def reads_text(self, cfg: DictConfig) -> bool:
        """Nearest is by the configuration's text features."""
        return True

    def open(self, scorer: Scorer, row: Row) -> Source:
        """Make what answers."""
        from kinema.evaluation.sources import NearestTrainingCaption

        store = scorer.store
        text = scorer.text("train", scorer.protocol.split)
        return NearestTrainingCaption(store, store.split_entries("train"), text)

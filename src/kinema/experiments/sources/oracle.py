"""Score what knows a part of what the prompt's motion shows."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from omegaconf import DictConfig

from kinema.data.labels import has_labels, require_labels, shown_by
from kinema.data.store import PackedStore
from kinema.experiments.config import plain
from kinema.experiments.corpus import open_corpus
from kinema.experiments.sources.base import ScoredSource

if TYPE_CHECKING:
    from kinema.evaluation.source import Source
    from kinema.experiments.evaluation import Row
    from kinema.experiments.scoring import Scorer


class OracleSource(ScoredSource):
    """Show a training clip of the right action or of the right style, as `oracle` says."""

    name = "oracle"
    groups = ("oracle",)

    def check(self, cfg: DictConfig, store: PackedStore) -> None:
        """Its corpus says what clips show."""
        require_labels(store)

    def suits(self, cfg: DictConfig) -> bool:
        """Corpora without labels have no such row."""
        return has_labels(PackedStore.open(open_corpus(cfg)))

    def label(self, cfg: DictConfig) -> str:
        """Name what it knows."""
        return f"{self.name}_{cfg.oracle.knows}"

    def open(self, scorer: Scorer, row: Row) -> Source:
        """Make what answers."""
        from kinema.evaluation.oracle import Oracle

        store = scorer.store
        train, shown = store.split_entries("train"), partial(shown_by, store)
        return Oracle(store, train, shown, **plain(scorer.cfg.oracle))

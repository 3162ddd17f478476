"""Say what a source of motion is to a row: how the row is named and told apart, what it needs, how it is opened."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

from omegaconf import DictConfig

from kinema.data.store import PackedStore
from kinema.experiments.config import plain

if TYPE_CHECKING:
    from kinema.evaluation.source import Source
    from kinema.experiments.evaluation import Row
    from kinema.experiments.scoring import Scorer


class ScoredSource:
    """Answer captions in a row of a table; what it costs to import is paid when it is opened.

    `name` is what `source=` calls it, `scores` the stage whose run's motion it shows (None: no run's), `groups` the
    keys of the configuration that are its own.
    """

    name: ClassVar[str]
    scores: ClassVar[str | None] = None
    groups: ClassVar[tuple[str, ...]] = ()

    def check_options(self, cfg: DictConfig) -> None:
        """Raise ValueError for options that it doesn't have."""
        if cfg.task != "generation":
            raise ValueError(f"task={cfg.task} with source={self.name}; only source=generation has tasks")
        if cfg.precision != "float32":
            raise ValueError(
                f"precision={cfg.precision} is how a generator computes, and source={self.name} has none; leave it out"
            )

    def check_run(self, cfg: DictConfig) -> None:
        """Raise ValueError if the run that `run=` names isn't what the configuration says how to ask."""

    def check(self, cfg: DictConfig, store: PackedStore) -> None:
        """Raise ValueError if the configuration or the corpus doesn't fit, before anything is made for it."""

    def suits(self, cfg: DictConfig) -> bool:
        """Say whether a table has the row for the configuration's corpus."""
        return True

    def read_groups(self, cfg: DictConfig) -> tuple[str, ...]:
        """Name those of its groups that change this row."""
        return self.groups

    def sampling(self, cfg: DictConfig) -> dict[str, Any] | None:
        """Return the spec of how its motion is sampled."""
        return None

    def lengths(self, cfg: DictConfig) -> str:
        """Say where the lengths of its motion come from: the test clips ("real") or the method ("predicted")."""
        return "real"

    def reads_text(self, cfg: DictConfig) -> bool:
        """Say whether it reads what the configuration's text encoder makes; a run that is given has its own."""
        return False

    def check_text(self, row: Row) -> None:
        """Find the text encoder of its own that it reads captions with, if it has one."""

    def label(self, cfg: DictConfig) -> str:
        """Say in the row's name what it is."""
        return self.name

    def notes(self, cfg: DictConfig) -> tuple[str, ...]:
        """Say below a table what a reader has to know of the row."""
        return ()

    def open(self, scorer: Scorer, row: Row) -> Source:
        """Make what answers; a subclass must."""
        raise TypeError(f"{type(self).__name__} says nothing of how it is opened; write its method open")

    def completed(self, metrics: dict[str, float]) -> dict[str, float]:
        """Return a replication's metrics under further names."""
        return {}

    def settings(self, cfg: DictConfig) -> dict[str, Any]:
        """Return the values of the groups that change this row."""
        return {group: plain(cfg[group]) for group in self.read_groups(cfg)}

"""Say what a stage is: one step of making a method or its judges, a run of its own."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from omegaconf import DictConfig, OmegaConf

from kinema.data.store import PackedStore
from kinema.experiments.config import plain
from kinema.experiments.corpus import open_split
from kinema.runs.folder import RunFolder
from kinema.runs.latest import find_run
from kinema.runs.parts import upstream


@dataclass(frozen=True)
class Summary:
    """Hold what status.json keeps of how a run was made."""

    seconds: float
    step: int | None = None
    val_loss: float | None = None
    parameters: int = 0
    device: str | None = None


class Stage:
    """Make one part of a method or of its judges; subclasses fit a model (`FittedStage`) or build what needs no fit.

    `name` is the folder of its runs and what other runs' upstream.json call it; `node` its place in the configuration;
    `needs` the stages whose runs change its own, `reads` the further keys of the configuration that do; `needed_by`
    are stages that need this one without naming it, `companion_of` those whose users want its run beside theirs,
    `completes` those of its `needs` whose run it stands beside once both are made, with a `sampling` of its own.
    `on_all_ranks`: several processes make it together, and it is for the first to write.
    """

    name: ClassVar[str]
    node: ClassVar[str]
    needs: ClassVar[tuple[str, ...]] = ()
    needed_by: ClassVar[tuple[str, ...]] = ()
    companion_of: ClassVar[tuple[str, ...]] = ()
    completes: ClassVar[tuple[str, ...]] = ()
    reads: ClassVar[tuple[str, ...]] = ()
    on_all_ranks: ClassVar[bool] = False

    def config(self, cfg: DictConfig) -> Any:
        """Return the stage's own part of the configuration; None where it has none."""
        return OmegaConf.select(cfg, self.node)

    def present(self, cfg: DictConfig) -> bool:
        """Say whether the configuration has this stage; identities and plans leave an absent one out."""
        return self.config(cfg) is not None

    def label(self, cfg: DictConfig) -> str:
        """Say in the run's name what it holds."""
        return self.name

    def settings(self, cfg: DictConfig) -> dict[str, Any]:
        """Return what of the stage's own part changes the result."""
        return plain(self.config(cfg))

    def given(self, cfg: DictConfig) -> Path | None:
        """Return the run that the configuration names in place of its own: a part of the run that `run=` names."""
        run = asked_for(cfg)
        return None if run is None else upstream(run).get(self.name)

    def seed(self, cfg: DictConfig) -> int:
        """Return the seed of its weights and draws."""
        return cfg.seed

    def split(self, cfg: DictConfig) -> str | None:
        """Name the split of the corpus that it learns from; None is the corpus' own."""
        return cfg.data.options.get("split")

    def corpus(self, cfg: DictConfig) -> PackedStore:
        """Open the corpus that it learns from."""
        return PackedStore.open(open_split(cfg, self.split(cfg)))

    def beside(self, cfg: DictConfig) -> bool:
        """Say whether an evaluation reads this run beside that of which it is a companion, or which it completes."""
        return self.given(cfg) is not None if cfg.get("run") else self.present(cfg)

    def watched_by(self, cfg: DictConfig) -> list[Stage]:
        """Return the stages whose runs judge this one while it is made; they are made before and change nothing."""
        return []

    def selects(self, cfg: DictConfig) -> bool:
        """Say whether the judgement chooses what is kept: then what judges is part of the run's identity."""
        return False

    def check(self, cfg: DictConfig, store: PackedStore) -> None:
        """Raise ValueError if the configuration or the corpus doesn't fit, before anything is made."""

    def make(self, cfg: DictConfig, store: PackedStore, needs: dict[str, RunFolder], folder: RunFolder) -> Summary:
        """Write the run's weights, from the finished runs that it needs."""
        raise TypeError(f"{type(self).__name__} says nothing of how it is made; write its method make")


def asked_for(cfg: DictConfig, key: str = "run") -> Path | None:
    """Return the folder that the configuration names under a key: a path, or `latest:METHOD`."""
    run = OmegaConf.select(cfg, key)
    return find_run(run, cfg.paths.runs) if run else None


def dims(cfg: DictConfig) -> str:
    """Name the method's representation as its option is called."""
    kind, variant = cfg.representation.kind, cfg.representation.variant
    return variant if (kind, variant) == ("redundant", "published") else kind


def given_run(cfg: DictConfig, stage: Stage) -> RunFolder | None:
    """Find the run that stands in for a stage's own; raises FileNotFoundError if that has no weights."""
    path = stage.given(cfg)
    if path is None:
        return None
    run = RunFolder(path.resolve())
    if not run.weights.exists():
        raise FileNotFoundError(
            f"{path} holds no {run.weights.name}; give the folder of a finished or imported {stage.name} run"
        )
    from kinema.runs.parts import check_part  # here: what asks for a finished run does not pay for torch

    check_part(run.path, stage.name)
    return run

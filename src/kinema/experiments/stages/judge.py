"""Fit what judges motion: the bases of the evaluators' stages."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from omegaconf import DictConfig

from kinema.data.store import PackedStore
from kinema.evaluation.encoders.base import Vocabulary
from kinema.experiments.stages.base import asked_for
from kinema.experiments.stages.fitted import FittedStage
from kinema.runs.folder import RunFolder

if TYPE_CHECKING:
    from kinema.training.modules import StageModule
    from kinema.training.recipe import Recipe


class EvaluatorStage(FittedStage):
    """Fit a part of the evaluators: they have a representation of their own and know no method."""

    def label(self, cfg: DictConfig) -> str:
        """Name the evaluator and its dims."""
        return f"evaluator_{cfg.evaluator.name}-{cfg.evaluator.representation}"

    def seed(self, cfg: DictConfig) -> int:
        """Return the evaluators' own seed: runs of other seeds are judged by the same ones."""
        return cfg.evaluator.seed

    def split(self, cfg: DictConfig) -> str | None:
        """Name the split that evaluators learn from, however the corpus is divided for methods."""
        return cfg.evaluator.split

    def dims(self, cfg: DictConfig) -> str:
        """Name the columns that the evaluator reads."""
        return cfg.evaluator.representation


class JudgeStage(EvaluatorStage):
    """Fit an evaluator of motion and text; `given_as` is its key in the configuration's `evaluators`."""

    given_as: ClassVar[str]
    optional: ClassVar[bool] = False
    """Say whether rows can do without its scores."""

    def given(self, cfg: DictConfig) -> Path | None:
        """Return the run of an imported evaluator."""
        return asked_for(cfg, f"evaluators.{self.given_as}")

    def vocabulary(self, cfg: DictConfig) -> Vocabulary:
        """Return what it reads captions with; its model's width follows."""
        raise TypeError(f"{type(self).__name__} has no vocabulary; write its method vocabulary")

    def module(
        self, cfg: DictConfig, model: Any, recipe: Recipe, store: PackedStore, needs: dict[str, RunFolder]
    ) -> StageModule:
        """Attach the vocabulary."""
        model.attach(self.vocabulary(cfg))
        return super().module(cfg, model, recipe, store, needs)

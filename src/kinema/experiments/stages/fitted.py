"""Fit a model with Lightning: what the stages that train have in common."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from omegaconf import DictConfig, OmegaConf

from kinema.data.store import PackedStore
from kinema.experiments.config import plain
from kinema.experiments.corpus import require_captions, require_windows
from kinema.experiments.stages.base import Stage, Summary
from kinema.runs.build import build
from kinema.runs.folder import RunFolder

if TYPE_CHECKING:  # and below where it is used: a finished run must not pay for Lightning
    from kinema.training.modules import StageModule
    from kinema.training.observers import Observer
    from kinema.training.recipe import Recipe
    from kinema.training.record import Record

PACE = ("validate_every", "checkpoint_every", "val_batches")
"""Keys of a recipe that can't change the weights where the validation loss doesn't choose them."""


class FittedStage(Stage):
    """Fit the `model` of the stage's node by the recipe in its `train`; a model without a recipe is only built."""

    on_all_ranks = True

    def present(self, cfg: DictConfig) -> bool:
        """Say whether the configuration has a model for this stage."""
        return super().present(cfg) and self.config(cfg).model is not None

    def settings(self, cfg: DictConfig) -> dict[str, Any]:
        """Return the model, and of its recipe what can change the weights that are kept."""
        own = plain(self.config(cfg))
        train = dict(own.get("train") or {})
        left_out = ("checkpoint_every",) if train.get("select") == "best" else PACE
        return {
            "model": own["model"],
            "train": {k: v for k, v in train.items() if k not in left_out},
            "precision": cfg.trainer.precision,
            "debug": cfg.debug.steps,
        }

    def selects(self, cfg: DictConfig) -> bool:
        """Say whether its recipe keeps the weights of the least FID."""
        return OmegaConf.select(cfg, f"{self.node}.train.select") == "fid"

    def dims(self, cfg: DictConfig) -> str:
        """Name the columns of motion that the stage reads: essential or redundant."""
        return cfg.representation.kind

    def spec(self, cfg: DictConfig) -> dict[str, Any]:
        """Return the plain spec that kinema.runs.build makes the model of."""
        return plain(self.config(cfg).model)

    def sketch(self, cfg: DictConfig) -> Any:
        """Build the model without memory, to compare it with others before any of them is made."""
        with torch.device("meta"):
            return build(self.spec(cfg), at=f"{self.node}.model")

    def check(self, cfg: DictConfig, store: PackedStore) -> None:
        """Check the options of model and recipe, and that there are captions for a recipe that reads them."""
        from kinema.experiments.training import check_options

        check_options(self, cfg, store)
        self.sketch(cfg)
        if self.selects(cfg) and not self.watched_by(cfg):
            raise ValueError(
                f"{self.node}.train.select=fid keeps the weights of the best score, and the {self.name} isn't scored; "
                "set callbacks.score_every if it is a generator, or choose last or best"
            )
        train = self.config(cfg).get("train")
        if train and train.data == "clips":
            require_captions(store, "train", "val")
        elif train:
            require_windows(store, train.get("window", 64), train.get("legacy_windows", False), "train", "val")

    def prepare(self, model: Any, store: PackedStore) -> None:
        """Give a new model what it keeps of the corpus: statistics."""
        from kinema.motion.representation import Representation

        for part in model.modules():
            if isinstance(part, Representation):
                part.fit(store.statistics)

    def finish(self, model: Any, store: PackedStore) -> None:
        """Give a trained model what it keeps of the corpus as it sees it now."""

    def module(
        self, cfg: DictConfig, model: Any, recipe: Recipe, store: PackedStore, needs: dict[str, RunFolder]
    ) -> StageModule:
        """Wire the model to what its loss reads; by default motion alone."""
        from kinema.training.modules import MotionModule

        return MotionModule(model, recipe, self.seed(cfg))

    def callbacks(
        self, cfg: DictConfig, module: Any, store: PackedStore, needs: dict[str, RunFolder], record: Record
    ) -> list[Observer]:
        """Return what else happens while it trains."""
        return []

    def metadata(self, cfg: DictConfig, module: Any, needs: dict[str, RunFolder], folder: RunFolder) -> dict[str, Any]:
        """Return what the weights say of themselves, and write what lies beside them."""
        return {}

    def make(self, cfg: DictConfig, store: PackedStore, needs: dict[str, RunFolder], folder: RunFolder) -> Summary:
        """Fit the model, resuming where a checkpoint is, and write its weights."""
        from kinema.experiments import training

        return training.make_model(self, cfg, store, needs, folder)

"""Fit the T2M-style evaluator: motion and text match by distance (T2M_EVALUATOR §4-§5)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from kinema.data.store import PackedStore
from kinema.experiments.instantiate import read_model
from kinema.experiments.stages.judge import JudgeStage
from kinema.runs.folder import RunFolder
from kinema.text.words import WordVectors, word_vectors

if TYPE_CHECKING:
    from kinema.training.modules import StageModule
    from kinema.training.recipe import Recipe


class MatchingStage(JudgeStage):
    """Fit the evaluator on the movements of the decomposition stage's encoder."""

    name = "matching"
    node = "evaluator.matching"
    needs = ("decomposition",)
    reads = ("evaluator.words", "evaluator.words_path")
    given_as = "t2m"

    def vocabulary(self, cfg: DictConfig) -> WordVectors:
        """Return the word vectors."""
        return word_vectors(cfg.evaluator.words, path=cfg.evaluator.words_path)

    def spec(self, cfg: DictConfig) -> dict[str, Any]:
        """Return the model's spec, as wide as the word vectors."""
        return {**super().spec(cfg), "word_width": self.vocabulary(cfg).width}

    def module(
        self, cfg: DictConfig, model: Any, recipe: Recipe, store: PackedStore, needs: dict[str, RunFolder]
    ) -> StageModule:
        """Take over the movement encoder."""
        (encoder,) = self.needs
        model.load_movement(read_model(needs[encoder].path, encoder))
        return super().module(cfg, model, recipe, store, needs)

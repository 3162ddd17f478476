"""Fit what predicts a motion's length from its text (MARDM §6)."""

from __future__ import annotations

from omegaconf import DictConfig

from kinema.experiments.stages.conditioned import ConditionedStage


class LengthStage(ConditionedStage):
    """Fit the length estimator: one serves every method that reads the same text encoder."""

    name = "length"
    node = "length"
    companion_of = ("generator",)

    def dims(self, cfg: DictConfig) -> str:
        """Motion's length is all that it reads: the fewer columns, the better."""
        return "essential"

    def beside(self, cfg: DictConfig) -> bool:
        """Lengths are predicted by an estimator where a method asks for them and doesn't predict them itself."""
        asked = cfg.task == "generation" and cfg.lengths == "predicted" and not cfg.generator.get("predicts_length")
        return asked and super().beside(cfg)

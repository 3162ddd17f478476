"""Fit the CLIP-style evaluator: motion and text match by cosine (CLIP_EVALUATOR)."""

from __future__ import annotations

from typing import Any

from omegaconf import DictConfig

from kinema.experiments.stages.judge import JudgeStage
from kinema.text.tokens import TokenTable, clip_tokens


class ContrastiveStage(JudgeStage):
    """Fit the evaluator behind the CLIP-score."""

    name = "contrastive"
    node = "evaluator.contrastive"
    reads = ("evaluator.tokens", "evaluator.tokens_path")
    given_as = "clip"
    optional = True

    def vocabulary(self, cfg: DictConfig) -> TokenTable:
        """Return the token table."""
        return clip_tokens(cfg.evaluator.tokens, path=cfg.evaluator.tokens_path)

    def spec(self, cfg: DictConfig) -> dict[str, Any]:
        """Return the model's spec, as wide as the token table."""
        return {**super().spec(cfg), "token_width": self.vocabulary(cfg).embedding.shape[1]}

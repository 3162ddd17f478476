"""Fit the movement encoder of the T2M-style evaluator (T2M_EVALUATOR §3)."""

from __future__ import annotations

from kinema.experiments.stages.judge import EvaluatorStage


class DecompositionStage(EvaluatorStage):
    """Fit the autoencoder of short windows whose encoder the evaluator takes over."""

    name = "decomposition"
    node = "evaluator.decomposition"

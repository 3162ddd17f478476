"""Fit the transformer that completes the codes of a generator of base codes (MoMask §3)."""

from __future__ import annotations

from omegaconf import DictConfig

from kinema.data.store import PackedStore
from kinema.experiments.stages.base import dims
from kinema.experiments.stages.conditioned import ConditionedStage
from kinema.experiments.stages.generator import GeneratorStage


class ResidualStage(ConditionedStage):
    """Fit the residual transformer on the codes of the method's tokenizer."""

    name = "residual"
    node = "residual"
    needs = ("tokenizer",)
    companion_of = ("generator",)

    def label(self, cfg: DictConfig) -> str:
        """Name the transformer and its dims."""
        return f"{cfg.residual.name}_residual-{dims(cfg)}"

    def check(self, cfg: DictConfig, store: PackedStore) -> None:
        """Check that it fits its generator too."""
        super().check(cfg, store)
        GeneratorStage().sketch(cfg).attach(self.name, self.sketch(cfg))

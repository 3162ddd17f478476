"""Fit the network that samples a trained flow in a few steps (FRONTIER §9.8)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from kinema.data.store import PackedStore
from kinema.experiments.config import plain
from kinema.experiments.instantiate import machine_of, read_model
from kinema.experiments.stages.base import asked_for, dims
from kinema.experiments.stages.conditioned import ConditionedStage
from kinema.experiments.stages.generator import GeneratorStage
from kinema.runs.build import build
from kinema.runs.folder import RunFolder
from kinema.runs.parts import upstream

if TYPE_CHECKING:
    from kinema.training.modules import GeneratorModule
    from kinema.training.recipe import Recipe


class ShortcutStage(ConditionedStage):
    """Fit the shortcut from the generator's weights, by what the generator does in more steps."""

    name = "shortcut"
    node = "shortcut"
    needs = ("tokenizer", "generator")
    completes = ("generator",)

    def given(self, cfg: DictConfig) -> Path | None:
        """Return the run that `run=` names, if that was tuned from a generator, or what stands beside it."""
        run = asked_for(cfg)
        return run if run is not None and GeneratorStage.name in upstream(run) else super().given(cfg)

    def label(self, cfg: DictConfig) -> str:
        """Name the method, which its generator's run may share with others, and its dims."""
        return f"{cfg.method.name}-{dims(cfg)}"

    def spec(self, cfg: DictConfig) -> dict[str, Any]:
        """Return the model's spec; it holds the sampling that its users get by default."""
        return {**super().spec(cfg), "sampling": self.sampling(cfg)}

    def sampling(self, cfg: DictConfig) -> dict[str, Any]:
        """Return the sampling that stands in for the generator's."""
        return plain(self.config(cfg).sampling)

    def check(self, cfg: DictConfig, store: PackedStore) -> None:
        """Check the sampling under its own key, and that it fits its generator too."""
        build(self.sampling(cfg), at=f"{self.node}.sampling")
        super().check(cfg, store)
        GeneratorStage().sketch(cfg).attach(self.name, self.sketch(cfg))

    def module(
        self, cfg: DictConfig, model: Any, recipe: Recipe, store: PackedStore, needs: dict[str, RunFolder]
    ) -> GeneratorModule:
        """Start from the trained generator, and learn from it."""
        generator = GeneratorStage.name
        model.learn_from(read_model(needs[generator].path, generator).to(machine_of(cfg).device()))
        return super().module(cfg, model, recipe, store, needs)

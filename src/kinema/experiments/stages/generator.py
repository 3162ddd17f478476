"""Fit a method's generator: text to latents."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf

from kinema.data.store import PackedStore
from kinema.experiments.config import plain
from kinema.experiments.instantiate import machine_of, read_model
from kinema.experiments.stages.base import Stage, asked_for, dims
from kinema.experiments.stages.conditioned import ConditionedStage
from kinema.experiments.stages.matching import MatchingStage
from kinema.runs.build import build
from kinema.runs.folder import RunFolder
from kinema.runs.parts import upstream

if TYPE_CHECKING:
    from kinema.training.modules import GeneratorModule
    from kinema.training.observers import Observer
    from kinema.training.recipe import Recipe
    from kinema.training.record import Record


class GeneratorStage(ConditionedStage):
    """Fit the generator on its tokenizer's latents."""

    name = "generator"
    node = "generator"
    needs = ("tokenizer",)

    def label(self, cfg: DictConfig) -> str:
        """Name the method, its generator's size or variant, and its dims; methods of a family share their runs."""
        words = [cfg.method.get("family", cfg.method.name), cfg.generator.get("variant"), dims(cfg)]
        return "-".join(word for word in words if word)

    def spec(self, cfg: DictConfig) -> dict[str, Any]:
        """Return the model's spec; it holds the sampling that its users get by default."""
        return {**super().spec(cfg), "sampling": plain(self.config(cfg).sampling)}

    def check(self, cfg: DictConfig, store: PackedStore) -> None:
        """Check the sampling under its own key, too, and that a flow's grid of times is read."""
        sampling, grid = plain(self.config(cfg).sampling), OmegaConf.select(cfg, "diffusion.sampling.grid")
        build(sampling, at=f"{self.node}.sampling")
        if grid not in (None, "uniform") and "solver_grid" not in sampling:
            raise ValueError(
                f"diffusion.sampling.grid={grid} isn't read by method={cfg.method.name}; give it "
                f"+{self.node}.sampling.solver_grid={grid}"
            )
        if OmegaConf.select(cfg, "diffusion.sampling.clip_latents") and "clip_latents" not in sampling:
            raise ValueError(
                f"diffusion.sampling.clip_latents=true isn't read by method={cfg.method.name}, which clips nothing; "
                "leave it out"
            )
        super().check(cfg, store)

    def given(self, cfg: DictConfig) -> Path | None:
        """Return the run that `run=` names, or that which it was tuned from (of a shortcut)."""
        run = asked_for(cfg)
        return None if run is None else upstream(run).get(self.name, run)

    def module(
        self, cfg: DictConfig, model: Any, recipe: Recipe, store: PackedStore, needs: dict[str, RunFolder]
    ) -> GeneratorModule:
        """Attach what it has beside it in training already."""
        for name in model.parts:
            if name in needs:
                model.attach(name, read_model(needs[name].path, name).to(machine_of(cfg).device()))
        return super().module(cfg, model, recipe, store, needs)

    def watched_by(self, cfg: DictConfig) -> list[Stage]:
        """Return the evaluator that scores its motion while it trains, if asked for."""
        return [MatchingStage()] if cfg.callbacks.score_every else []

    def callbacks(
        self, cfg: DictConfig, module: Any, store: PackedStore, needs: dict[str, RunFolder], record: Record
    ) -> list[Observer]:
        """Draw sample motions and score motion every few steps, if asked for."""
        from kinema.experiments.previews import MotionSamples
        from kinema.experiments.watching import ValidationScores, Watched
        from kinema.training.observers import Samples, Scores

        beside = {k: run for k, run in upstream(record.folder).items() if k in module.model.parts and k not in needs}
        (source,) = self.needs
        watched = Watched(needs[source].path, module.text.value, beside)
        found: list[Observer] = []
        if cfg.callbacks.samples_every:
            found.append(Samples(cfg.callbacks.samples_every, record, MotionSamples(cfg, store, record, watched)))
        if cfg.callbacks.score_every:
            found.append(Scores(cfg.callbacks.score_every, record, ValidationScores(cfg, store, watched)))
        return found

"""Train one stage from its configuration: build, prepare, fit, save."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any

import torch
from omegaconf import DictConfig

from kinema.data.datamodule import KINDS, MotionDataModule
from kinema.data.datasets import ClipDataset
from kinema.data.store import PackedStore
from kinema.devices import global_rank
from kinema.experiments.config import plain
from kinema.experiments.dashboards import training_dashboards
from kinema.experiments.identity import fingerprint, run_identity
from kinema.experiments.instantiate import encode_captions, machine_of, read_model, text_encoder
from kinema.experiments.stages.base import Summary
from kinema.experiments.stages.fitted import FittedStage
from kinema.files.kinds import DamagedError
from kinema.generators import LatentModel
from kinema.options import Count, OneOf, Options, check, make
from kinema.pipeline.compatibility import check_pair
from kinema.runs import weights
from kinema.runs.build import build
from kinema.runs.console import console
from kinema.runs.folder import RunFolder
from kinema.seeds import training_seed
from kinema.tokenizers import MotionTokenizer
from kinema.training.fit import fit
from kinema.training.latents import EncodeEachTime, LatentCache, latent_source
from kinema.training.modules import GeneratorModule
from kinema.training.recipe import Recipe
from kinema.training.record import Record
from kinema.types import Latents, MotionBatch


@dataclass(frozen=True)
class Budget(Options):
    """What a recipe in the configuration has beside a `Recipe`: the kind of data, and epochs in place of steps.

    An epoch passes the corpus `repeats` times, as if that were one of so many times the size.
    """

    data: Annotated[str, OneOf(KINDS)]
    batch_size: Count
    steps: Count | None = None
    epochs: Count | None = None
    repeats: Count = 1

    def steps_of(self, items: int, at: str = "train") -> int:
        """Count the steps on a corpus of so many items: whole batches of each epoch. Raises ValueError naming `at`."""
        if self.steps is not None:
            return self.steps
        if self.epochs is None:
            raise ValueError(f"{at}.steps and {at}.epochs are both empty; set one of them")
        return max(1, self.repeats * items // self.batch_size) * self.epochs


def make_model(
    stage: FittedStage, cfg: DictConfig, store: PackedStore, needs: dict[str, RunFolder], folder: RunFolder
) -> Summary:
    """Fit a stage's model, or take it as it is built where it has no recipe, and write its weights."""
    machine = machine_of(cfg)
    device = machine.device()
    machine.limit_threads()
    started, train = time.monotonic(), plain(stage.config(cfg)).get("train")
    recipe = make_recipe(train, store, debug_steps=cfg.debug.steps) if train else None
    model, spec = initial_model(stage, cfg, store)
    meta: dict[str, Any] = {"part": stage.name, "label": folder.path.name, "corpus": store.hash}
    if recipe is None:
        if global_rank() == 0:
            weights.save(model, spec, folder.weights, **meta)
        return Summary(round(time.monotonic() - started, 1), device=str(device))
    module = stage.module(cfg, model, recipe, store, needs)
    data = MotionDataModule(
        store.path,
        kind=train["data"],
        batch_size=recipe.batch_size,
        window=recipe.window,
        seed=stage.seed(cfg),
        steps=recipe.steps,
        num_workers=cfg.data.workers,
        legacy_windows=recipe.legacy_windows,
        dims=stage.dims(cfg),
    )
    if (size := data.filled()) < recipe.batch_size and global_rank() == 0:
        asked = f"{stage.node}.train.batch_size={recipe.batch_size}"
        console.print(f"[yellow]note[/]      {asked}, but the train split has {size} {train['data']}: a batch is all")
    with training_dashboards(cfg, folder.path, stage.name) as dashboards:
        record = Record(folder.path, dashboards)
        callbacks = stage.callbacks(cfg, module, store, needs, record)
        fitted = fit(module, data, folder.path, machine, callbacks=callbacks, record=record)
        if global_rank() == 0:
            model.load_state_dict(fitted.weights)
            stage.finish(model.to(device), store)
            model.cpu()
            meta |= {"step": fitted.step, **stage.metadata(cfg, module, needs, folder)}
            weights.save(model, spec, folder.weights, **meta)
        for dashboard in dashboards if cfg.logger.artifacts else ():
            dashboard.artifact([folder.weights, folder.path / "config.yaml"])
    trainable = sum(p.numel() for p in model.parameters() if p.requires_grad)
    return Summary(round(fitted.seconds, 1), fitted.step, fitted.val_loss, trainable, str(device))


def check_options(stage: FittedStage, cfg: DictConfig, store: PackedStore) -> None:
    """Raise ValueError naming a machine that isn't there, or an option of the recipe that is wrong."""
    machine_of(cfg).check()
    if train := plain(stage.config(cfg)).get("train"):
        make_recipe(train, store, at=f"{stage.node}.train")


def initial_model(stage: FittedStage, cfg: DictConfig, store: PackedStore) -> tuple[Any, dict[str, Any]]:
    """Build a stage's model from its own seed, with the corpus' statistics; returns it and its spec."""
    torch.manual_seed(training_seed(stage.seed(cfg), "init", stage.name))
    spec = stage.spec(cfg)
    model = build(spec)
    stage.prepare(model, store)
    return model, spec


def make_recipe(train: dict[str, Any], store: PackedStore, debug_steps: int | None = None, at: str = "train") -> Recipe:
    """Turn a recipe's config into numbers; `epochs` become steps of this corpus. Raises ValueError naming an option."""
    own = {field.name for kind in (Budget, Recipe) for field in fields(kind)}
    for name in sorted(train.keys() - own):
        raise ValueError(f"{at}.{name} is no option; a recipe has {', '.join(sorted(own))}")
    budget = read_budget(train, at)
    values = {k: v for k, v in train.items() if k not in ("data", "epochs", "repeats")}
    check(Recipe, {k: v for k, v in values.items() if k != "steps"}, at)
    if budget.steps is None:
        window = {k: train[k] for k in ("window", "legacy_windows") if k in train}
        probe = MotionDataModule(store.path, kind=budget.data, batch_size=1, steps=1, **window)
        values["steps"] = budget.steps_of(len(probe.dataset("train")), at)
    if debug_steps:
        values |= {"steps": debug_steps, "validate_every": debug_steps, "checkpoint_every": debug_steps}
    values |= {k: tuple(values[k]) for k in ("milestones", "betas", "clip_each") if k in values}
    recipe = make(Recipe, values, at)
    return replace(recipe, validate_every=min(recipe.validate_every, recipe.steps))


def read_budget(train: dict[str, Any], at: str = "train") -> Budget:
    """Take a recipe's budget from its config; raises ValueError naming an option."""
    return make(Budget, {k: v for k, v in train.items() if k in {field.name for field in fields(Budget)}}, at)


def generator_module(
    cfg: DictConfig, model: LatentModel, recipe: Recipe, store: PackedStore, tokenizer_run: RunFolder | None
) -> GeneratorModule:
    """Wire a model of latents to the captions, and to the latents of a tokenizer or the number of frames alone."""
    device = machine_of(cfg).device()
    text = encode_captions(text_encoder(cfg, device), store, "train", "val")
    if model.lacks_empty_text:
        model.take_empty_text(text.empty())
    if tokenizer_run is None:
        return GeneratorModule(model, recipe, cfg.seed, crop_lengths, text)
    tokenizer = read_model(tokenizer_run.path)
    check_pair(tokenizer, model)
    latents = _latents(cfg, tokenizer_run, tokenizer, store, device)
    model.prepare(tokenizer, latents)
    return GeneratorModule(model, recipe, cfg.seed, latents, text)


def _latents(
    cfg: DictConfig, run: RunFolder, tokenizer: MotionTokenizer, store: PackedStore, device: torch.device
) -> LatentCache | EncodeEachTime:
    """Look up what a tokenizer makes of the corpus: in its run, which those share that are trained on it.

    Of a run that this user may only read, whole latents are read without a lock, and others kept in the cache.
    """
    folder = run.path / f"latents-{store.hash}"
    if not _writable(run):
        try:
            if folder.is_dir():
                return LatentCache(folder)
        except (DamagedError, OSError) as error:
            console.print(f"[yellow]note[/]      {error!s}")
        folder = Path(cfg.paths.cache) / "latents" / fingerprint(run_identity(run.path)) / folder.name
    clips = [ClipDataset(store, split) for split in ("train", "val")]
    # Two generators may start on one tokenizer at once: the second waits, and finds the latents.
    with RunFolder(folder.parent).lock():
        return latent_source(folder, tokenizer, clips, device)


def _writable(run: RunFolder) -> bool:
    """Say whether this user can hold a run's lock and write into it."""
    lock = run.path / ".lock"
    return os.access(run.path, os.W_OK) and (not lock.exists() or os.access(lock, os.W_OK))


def crop_lengths(
    batch: MotionBatch, generator: torch.Generator | None = None, shard: tuple[int, int] = (0, 1)
) -> Latents:
    """Return latents that hold the number of frames alone (the length estimator reads nothing else)."""
    return Latents(lengths=batch.lengths, frames=batch.lengths)

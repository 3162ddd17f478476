"""Train one stage from its configuration: build, prepare, fit, save."""

from __future__ import annotations

import time
from dataclasses import fields, replace
from typing import Any

import torch
from omegaconf import DictConfig

from kinema.data.datamodule import KINDS, MotionDataModule
from kinema.data.datasets import ClipDataset
from kinema.data.store import PackedStore
from kinema.devices import find_device, global_rank
from kinema.experiments.config import plain
from kinema.experiments.dashboards import check_logger, training_dashboards
from kinema.experiments.instantiate import encode_captions, read_model, text_encoder
from kinema.experiments.stages.base import Summary
from kinema.experiments.stages.fitted import FittedStage
from kinema.generators import LatentModel
from kinema.motion.representation import Representation
from kinema.pipeline.compatibility import check_pair
from kinema.runs import weights
from kinema.runs.build import build
from kinema.runs.console import console
from kinema.runs.folder import RunFolder
from kinema.seeds import training_seed
from kinema.training.fit import Machine, fit
from kinema.training.latents import latent_source
from kinema.training.modules import GeneratorModule
from kinema.training.recipe import Recipe
from kinema.training.record import Record
from kinema.types import Latents, MotionBatch

NUMBERS = ("steps", "epochs", "batch_size", "lr", "weight_decay", "warmup", "validate_every", "checkpoint_every")


def make_model(
    stage: FittedStage, cfg: DictConfig, store: PackedStore, needs: dict[str, RunFolder], folder: RunFolder
) -> Summary:
    """Fit a stage's model, or take it as it is built where it has no recipe, and write its weights."""
    machine, device = Machine(**plain(cfg.trainer)), find_device(cfg.trainer.accelerator)
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
            meta |= {"step": fitted.step, **stage.metadata(cfg, module, needs, folder)}
            weights.save(model, spec, folder.weights, **meta)
        for dashboard in dashboards if cfg.logger.artifacts else ():
            dashboard.artifact([folder.weights, folder.path / "config.yaml"])
    trainable = sum(p.numel() for p in model.parameters() if p.requires_grad)
    return Summary(round(fitted.seconds, 1), fitted.step, fitted.val_loss, trainable, str(device))


def check_options(stage: FittedStage, cfg: DictConfig, store: PackedStore) -> None:
    """Raise ValueError naming an option of machine, logger or recipe that is wrong."""
    Machine(**plain(cfg.trainer))
    find_device(cfg.trainer.accelerator)
    check_logger(cfg)
    train = plain(stage.config(cfg)).get("train")
    if train:
        try:
            make_recipe(train, store)
        except ValueError as error:
            raise ValueError(f"{stage.node}.{error}") from None


def initial_model(stage: FittedStage, cfg: DictConfig, store: PackedStore) -> tuple[Any, dict[str, Any]]:
    """Build a stage's model from its own seed, with the corpus' statistics; returns it and its spec."""
    torch.manual_seed(training_seed(stage.seed(cfg), "init", stage.name))
    spec = stage.spec(cfg)
    model = build(spec)
    for part in model.modules():
        if isinstance(part, Representation):
            part.fit(store.statistics)
    return model, spec


def make_recipe(train: dict[str, Any], store: PackedStore, debug_steps: int | None = None) -> Recipe:
    """Turn a recipe's config into numbers; `epochs` become steps of this corpus. Raises ValueError naming an option."""
    options = {field.name for field in fields(Recipe)} | {"data", "epochs"}
    for name in sorted(train.keys() - options):
        raise ValueError(f"train.{name} is no option; a recipe has {', '.join(sorted(options))}")
    for name in NUMBERS:
        value = train.get(name) or 0
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(f"train.{name}={value!r}; it must be a number")
    if train.get("data") not in KINDS:
        raise ValueError(f"train.data={train.get('data')!r}; allowed: {', '.join(KINDS)}")
    values = {k: v for k, v in train.items() if k not in ("data", "epochs")}
    if values.get("steps") is None:
        if not train.get("epochs"):
            raise ValueError("train.steps and train.epochs are both empty; set one of them")
        window = {k: train[k] for k in ("window", "legacy_windows") if k in train}
        probe = MotionDataModule(store.path, kind=train["data"], batch_size=1, steps=1, **window)
        per_epoch = len(probe.dataset("train")) // train["batch_size"]
        values["steps"] = max(1, per_epoch) * train["epochs"]
    if debug_steps:
        values |= {"steps": debug_steps, "validate_every": debug_steps, "checkpoint_every": debug_steps}
    values |= {k: tuple(values[k] or ()) for k in ("milestones", "betas", "clip_each") if k in values}
    recipe = Recipe(**values)
    return replace(recipe, validate_every=min(recipe.validate_every, recipe.steps))


def generator_module(
    cfg: DictConfig, model: LatentModel, recipe: Recipe, store: PackedStore, tokenizer_run: RunFolder | None
) -> GeneratorModule:
    """Wire a model of latents to the captions, and to the latents of a tokenizer or the number of frames alone."""
    device = find_device(cfg.trainer.accelerator)
    text = encode_captions(text_encoder(cfg, device), store, "train", "val")
    if model.lacks_empty_text:
        model.take_empty_text(text.empty())
    if tokenizer_run is None:
        return GeneratorModule(model, recipe, cfg.seed, crop_lengths, text)
    tokenizer = read_model(tokenizer_run.path)
    check_pair(tokenizer, model)
    clips = [ClipDataset(store, split) for split in ("train", "val")]
    # Runs on one tokenizer and corpus share the cache: it belongs to the tokenizer's run.
    # Two generators may start on one tokenizer at once: the second waits, and finds the latents.
    with tokenizer_run.lock():
        latents = latent_source(tokenizer_run.path / f"latents-{store.hash[:12]}", tokenizer, clips, device)
    model.prepare(tokenizer, latents)
    return GeneratorModule(model, recipe, cfg.seed, latents, text)


def crop_lengths(
    batch: MotionBatch, generator: torch.Generator | None = None, shard: tuple[int, int] = (0, 1)
) -> Latents:
    """Return latents that hold the number of frames alone (the length estimator reads nothing else)."""
    return Latents(lengths=batch.lengths, frames=batch.lengths)

"""Train one stage from its configuration: build, prepare, fit, save."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig
from torch import nn

from kinema.data.datamodule import MotionDataModule
from kinema.data.datasets import ClipDataset
from kinema.data.store import PackedStore
from kinema.devices import find_device, global_rank
from kinema.experiments.config import plain
from kinema.experiments.instantiate import attach_text, encode_captions, model_spec, read_model, text_encoder
from kinema.experiments.previews import sample_drawer
from kinema.experiments.stages import Stage
from kinema.motion.representation import Representation
from kinema.pipeline.compatibility import check_pair
from kinema.runs import weights
from kinema.runs.build import build
from kinema.runs.folder import RunFolder
from kinema.runs.parts import write_text_encoder
from kinema.seeds import training_seed
from kinema.training.callbacks import Samples
from kinema.training.fit import Machine, fit
from kinema.training.latents import latent_source
from kinema.training.loggers import loggers
from kinema.training.modules import EvaluatorModule, GeneratorModule, LatentSource, StageModule, TokenizerModule
from kinema.training.recipe import Recipe
from kinema.types import Latents, MotionBatch


def train_stage(
    cfg: DictConfig, stage: Stage, store_path: Path, folder: RunFolder, upstream: dict[str, RunFolder]
) -> dict[str, Any]:
    """Fit a stage and write its weights; returns what status.json keeps (seconds, step, validation loss)."""
    machine, device = Machine(**plain(cfg.trainer)), find_device(cfg.trainer.accelerator)
    machine.limit_threads()
    store = PackedStore.open(store_path)
    node = plain(stage.config(cfg))
    recipe = make_recipe(node["train"], store_path, debug_steps=cfg.debug.steps)
    torch.manual_seed(training_seed(cfg.seed, "init", stage.name))
    spec = model_spec(cfg, stage)
    model = build(spec)
    for part in model.modules():
        if isinstance(part, Representation):
            part.fit(store.statistics)
    module = make_module(cfg, stage, model, recipe, store, upstream)
    data = MotionDataModule(
        store_path,
        kind=node["train"]["data"],
        batch_size=recipe.batch_size,
        window=recipe.window,
        seed=cfg.seed,
        steps=recipe.steps,
        num_workers=cfg.data.workers,
        legacy_windows=recipe.legacy_windows,
    )
    extra: list[Samples] = []
    if stage.name == "generator" and cfg.callbacks.samples_every:
        draw = sample_drawer(cfg, store, read_model(upstream["tokenizer"].path)[0], module.text.value)
        extra = [Samples(folder.path / "samples", cfg.callbacks.samples_every, draw)]
    config, logger = plain(cfg), plain(cfg.logger)
    with loggers(logger.pop("names"), folder.path, **logger, config=config) as attached:
        fitted = fit(module, data, folder.path, machine, callbacks=extra, loggers=attached)
    summary = {
        "seconds": round(fitted.seconds, 1),
        "step": fitted.step,
        "val_loss": fitted.val_loss,
        "parameters": sum(p.numel() for p in model.parameters() if p.requires_grad),
        "device": str(device),
    }
    if global_rank() > 0:
        return summary
    model.load_state_dict(fitted.weights)
    meta = {"part": stage.name, "label": folder.path.name, "corpus": store.manifest["hash"], "step": fitted.step}
    if "tokenizer" in upstream:
        meta["representation"] = read_model(upstream["tokenizer"].path)[0].representation.identity()
    if "text" in stage.reads:
        write_text_encoder(folder.path, cfg.text.name, cfg.text.path)
        meta["text"] = module.text.value.identity
    weights.save(model, spec, folder.weights, **meta)
    return summary


def make_recipe(train: dict[str, Any], store: Path, debug_steps: int | None = None) -> Recipe:
    """Turn a recipe's config into numbers; `epochs` become steps of this corpus."""
    values = {k: v for k, v in train.items() if k not in ("data", "epochs")}
    if values.get("steps") is None:
        if not train.get("epochs"):
            raise ValueError("train.steps and train.epochs are both empty; set one of them")
        window = {k: train[k] for k in ("window", "legacy_windows") if k in train}
        probe = MotionDataModule(store, kind=train["data"], batch_size=1, steps=1, **window)
        per_epoch = len(probe.dataset("train")) // train["batch_size"]
        values["steps"] = max(1, per_epoch) * train["epochs"]
    if debug_steps:
        values |= {"steps": debug_steps, "validate_every": debug_steps, "checkpoint_every": debug_steps}
    values["milestones"] = tuple(values.get("milestones") or ())
    try:
        recipe = Recipe(**values)
        return replace(recipe, validate_every=min(recipe.validate_every, recipe.steps))
    except TypeError as error:
        raise ValueError(f"train config: {error}; the fields are those of kinema.training.recipe.Recipe") from None


def make_module(
    cfg: DictConfig, stage: Stage, model: nn.Module, recipe: Recipe, store: PackedStore, upstream: dict[str, RunFolder]
) -> StageModule:
    """Wire a model to what its loss reads."""
    if stage.name in ("tokenizer", "decomposition"):
        return TokenizerModule(model, recipe, cfg.seed)
    if stage.owner == "evaluator":
        attach_text(cfg, stage, model)
        if "decomposition" in upstream:
            model.load_movement(read_model(upstream["decomposition"].path)[0])
        return EvaluatorModule(model, recipe, cfg.seed)
    device = find_device(cfg.trainer.accelerator)
    text = encode_captions(text_encoder(cfg, device), store, "train", "val")
    latents: LatentSource = crop_lengths
    if "tokenizer" in upstream:
        tokenizer, _ = read_model(upstream["tokenizer"].path)
        check_pair(tokenizer, model)
        clips = [ClipDataset(store, split) for split in ("train", "val")]
        # Runs on one tokenizer and corpus share the cache: it belongs to the tokenizer's run.
        # Two generators may start on one tokenizer at once: the second waits, and finds the latents.
        with upstream["tokenizer"].lock():
            where = upstream["tokenizer"].path / f"latents-{store.hash[:12]}"
            latents = latent_source(where, tokenizer, clips, device)
        model.prepare(tokenizer, latents)
    return GeneratorModule(model, recipe, cfg.seed, latents, text)


def crop_lengths(batch: MotionBatch, generator: torch.Generator | None = None) -> Latents:
    """Return latents that hold the number of frames alone (the length estimator reads nothing else)."""
    return Latents(lengths=batch.lengths, frames=batch.lengths)

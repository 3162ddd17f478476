"""Count what each row of a table costs: operations of training steps and generated motions, and GPU hours of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from omegaconf import DictConfig

from kinema.data.store import PackedStore
from kinema.evaluation.cost import counting, operations, parameters
from kinema.evaluation.settings import EvaluationProtocol
from kinema.experiments.config import compose, plain
from kinema.experiments.corpus import open_corpus
from kinema.experiments.pages.sections import Rows, Section, write_page
from kinema.experiments.pages.untrained import untrained
from kinema.experiments.request import Request
from kinema.experiments.sampling import build_sampling
from kinema.experiments.stages import get_stage
from kinema.experiments.stages.generator import GeneratorStage
from kinema.experiments.stages.tokenizer import TokenizerStage
from kinema.experiments.training import read_budget
from kinema.pipeline import TextToMotion
from kinema.runs.console import console
from kinema.runs.versions import versions
from kinema.types import Caption, MotionBatch

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TEXT = "a person walks"


def carry_out(page: dict[str, Any], request: Request) -> list[Path]:
    """Count every method, and write the page; it keeps nothing to render."""
    rows: Rows = []
    for spec in page["methods"]:
        own = [*request.shared, *page["overrides"], f"method={spec['method']}", *spec.get("overrides", [])]
        cfg = compose(own, "evaluate")
        rows += [{"method": spec["label"], **row} for row in count(cfg, page)]
        hours = sum(row["GPU hours"] for row in rows if row["method"] == spec["label"])
        console.print(f"counted   {spec['label']}: {hours:.3g} GPU hours")
    section = Section("costs", rows, rows, partial(_draw, rows=rows), (8.0, 4.0))
    facts = {"command": request.command, "tflops": page["tflops"], "versions": versions()}
    return write_page(page, [section], facts, request.folder(cfg))


def count(cfg: DictConfig, page: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Return a row for each part that is trained, and one for the evaluation."""
    store = PackedStore.open(open_corpus(cfg))
    motions = clips(store, page["motions"], page["frames"])
    model = untrained(cfg, store, motions)
    for part, network in trained(model).items():
        train = plain(get_stage(part).config(cfg))["train"]
        steps = read_budget(train).steps_of(page[train["data"]])
        each = training_step(model, part, motions, train.get("window", 64) if train["data"] == "windows" else None)
        row = {"part": f"training the {part}", "parameters": parameters(network), "batch": train["batch_size"]}
        yield row | _hours(each * train["batch_size"] / page["motions"], steps, page)
    protocol = EvaluationProtocol(**plain(cfg.scale.protocol))
    asked = protocol.replications * (page["tested"] + protocol.mm_texts * (protocol.mm_repeats - 1))
    each = operations(model, TEXT, page["frames"], sampling=build_sampling(cfg), seed=cfg.seed)
    yield {"part": "evaluation", "parameters": None, "batch": None} | _hours(each, asked, page)


def trained(model: TextToMotion) -> dict[str, Any]:
    """Return the parts of a method that learn, by their names."""
    parts = {TokenizerStage.name: model.tokenizer, GeneratorStage.name: model.generator, **model.parts}
    return {name: part for name, part in parts.items() if any(p.requires_grad for p in part.parameters())}


def clips(store: PackedStore, size: int, frames: int) -> MotionBatch:
    """Return that many clips of that many frames: what they show changes no operation."""
    generator = torch.Generator().manual_seed(0)
    scale = torch.from_numpy(store.statistics.std).float()
    values = torch.randn(size, frames, store.skeleton.feature_width, generator=generator) * scale
    captions = [Caption(TEXT, ("a/DET", "person/NOUN", "walk/VERB"))] * size
    return MotionBatch(values, torch.full((size,), frames), captions=captions, clip_ids=[str(i) for i in range(size)])


def training_step(model: TextToMotion, part: str, motions: MotionBatch, window: int | None) -> int:
    """Count the operations of one loss of a part, and of its gradients; a tokenizer's of windows."""
    network = trained(model)[part].train()
    draws = torch.Generator().manual_seed(0)
    if network is model.tokenizer:
        frames = window or motions.features.shape[1]
        batch = replace(motions, features=motions.features[:, :frames], lengths=motions.lengths.clamp(max=frames))
        with counting() as counter:
            network.loss(batch, generator=draws)["loss"].backward()
    else:
        with torch.no_grad():
            latents, text = model.tokenizer.eval().encode(motions), model.text_encoder(motions.texts)
        text.clip_ids = motions.clip_ids
        with counting() as counter:
            network.loss(latents, text, generator=draws)["loss"].backward()
    return counter.get_total_flops()


def _hours(each: float, count: int, page: dict[str, Any]) -> dict[str, Any]:
    return {"GFLOP": each / 1e9, "count": count, "GPU hours": each * count / (page["tflops"] * 1e12) / 3600}


def _draw(figure: Figure, rows: Rows) -> None:
    """Draw a bar for each method, its parts side by side."""
    axes = figure.subplots()
    methods = list(dict.fromkeys(row["method"] for row in rows))[::-1]
    left = dict.fromkeys(methods, 0.0)
    for part in dict.fromkeys(row["part"] for row in rows):
        widths = {row["method"]: row["GPU hours"] for row in rows if row["part"] == part}
        axes.barh(methods, [widths.get(m, 0) for m in methods], left=[left[m] for m in methods], label=part)
        left = {m: left[m] + widths.get(m, 0) for m in methods}
    axes.set_xlabel("GPU hours, computed", fontsize=8)
    axes.tick_params(labelsize=8)
    axes.legend(fontsize=7)

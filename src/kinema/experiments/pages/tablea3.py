"""Time every method from sentences to motions, at the sizes of a scale; nothing is trained for it."""

from __future__ import annotations

import os
import platform
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from omegaconf import DictConfig

from kinema.data.store import PackedStore
from kinema.evaluation.latency import PARTS, Latency, measure_latency
from kinema.experiments.config import compose
from kinema.experiments.corpus import open_corpus
from kinema.experiments.instantiate import machine_of
from kinema.experiments.pages.sections import Rows, Section, write_page
from kinema.experiments.pages.subjects import read_motions
from kinema.experiments.pages.untrained import untrained
from kinema.experiments.request import Request
from kinema.experiments.sampling import build_sampling
from kinema.runs.console import console
from kinema.runs.versions import versions
from kinema.types import MotionBatch

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def carry_out(page: dict[str, Any], request: Request) -> list[Path]:
    """Time every method, one after the other in this process (jobs would share the machine), and write the page.

    Raises ValueError for `render_only`: times are of this machine now, and none are kept.
    """
    if request.render_only:
        raise ValueError("tablea3 measures anew at every call and keeps nothing to render; leave --render-only out")
    shared = request.shared
    rows: Rows = []
    cfg = compose(shared, "evaluate")
    machine_of(cfg).limit_threads()
    store = PackedStore.open(open_corpus(cfg))
    asked = read_motions(store, "test", page["motions"])
    for spec in page["methods"]:
        own = compose([*shared, f"method={spec['method']}", *spec.get("overrides", [])], "evaluate")
        timed = time_method(spec, own, store, asked, page)
        told = ", ".join(f"batch {row['batch']} {row['s / motion']:.3g} s a motion" for row in timed)
        console.print(f"timed     {spec['label']}: {told}")
        rows += [{**row, "paper (s)": spec.get("paper") if row["batch"] == 1 else None} for row in timed]
    shown = [{key: value for key, value in row.items() if key != "key"} for row in rows]
    inches = (8.0, 0.35 * len(page["methods"]) + 1.5)
    section = Section("times", rows, shown, partial(_draw, rows=rows), inches)
    facts = {"command": request.command, **machine(cfg)}
    return write_page(page, [section], facts, request.folder(cfg))


def time_method(
    spec: dict[str, Any], cfg: DictConfig, store: PackedStore, asked: MotionBatch, page: dict[str, Any]
) -> Rows:
    """Return a row for each batch size."""
    model, sampling = untrained(cfg, store, asked), build_sampling(cfg)
    model = model.bfloat16() if cfg.precision == "bfloat16" else model
    lengths = asked.lengths.clamp(max=model.max_frames).tolist()
    found = []
    for size in page["batches"]:
        if len(lengths) < size:
            console.print(f"[yellow]note[/]      no batch of {size}: the test split has {len(lengths)} motions")
            continue
        timed = measure_latency(
            model, asked.texts, lengths, batch=size, warmup=page["warmup"], sampling=sampling, seed=cfg.seed
        )
        parameters = sum(p.numel() for p in model.generator.parameters())
        row = {"key": spec["key"], "method": spec["label"], "batch": size}
        found.append(row | summary(timed) | {"parameters": parameters})
    return found


def summary(timed: list[Latency]) -> dict[str, Any]:
    """Return means over batches: seconds a motion, in all and by part, and network calls a batch."""
    motions = sum(latency.motions for latency in timed)
    row: dict[str, Any] = {"s / motion": sum(latency.total for latency in timed) / motions}
    row |= {f"{part} (s)": sum(latency.seconds[part] for latency in timed) / motions for part in PARTS}
    calls = [sum(latency.calls.values()) for latency in timed if latency.calls]
    row["network calls"] = sum(calls) / len(calls) if calls else None
    return row | {"motions": motions}


def machine(cfg: DictConfig) -> dict[str, Any]:
    """Say what the times are of."""
    device = machine_of(cfg).device()
    name = torch.cuda.get_device_name(device) if device.type == "cuda" else _processor()
    facts = {"device": f"{device.type}, {name}", "threads": torch.get_num_threads(), "cores": os.cpu_count()}
    return facts | {"precision": cfg.precision, "weights": "as training begins", "versions": versions()}


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    named = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return named[0] if named else platform.processor() or platform.machine()


def _draw(figure: Figure, rows: Rows) -> None:
    """Draw a bar for each method, in batches of one: its parts side by side on a linear axis."""
    axes = figure.subplots()
    single = [row for row in rows if row["batch"] == min(r["batch"] for r in rows)]
    names = [row["method"] for row in single][::-1]
    left = [0.0] * len(single)
    for part in PARTS:
        widths = [row[f"{part} (s)"] for row in single][::-1]
        axes.barh(names, widths, left=left, label=part)
        left = [a + b for a, b in zip(left, widths, strict=True)]
    axes.set_xlabel("seconds for a motion, batch 1", fontsize=8)
    axes.tick_params(labelsize=8)
    axes.legend(fontsize=7)

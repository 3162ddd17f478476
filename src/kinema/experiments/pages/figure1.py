"""Draw FID against size (MARDM Figure 1): rows of Table A2, each with its parameters and operations."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kinema.data.store import PackedStore
from kinema.evaluation.cost import operations, parameters
from kinema.experiments.corpus import open_corpus
from kinema.experiments.pages.points import score, some_config
from kinema.experiments.pages.sections import Rows, Section, write_page
from kinema.experiments.pages.subjects import read_motions
from kinema.experiments.pages.untrained import untrained
from kinema.experiments.request import Request
from kinema.experiments.sampling import build_sampling
from kinema.experiments.table_files import load_table
from kinema.experiments.tables import TableRow
from kinema.report.intervals import measure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

METRICS = {"fid": "FID", "r3": "R@3"}
AREA = 600.0
"""Square points of the largest bubble."""


def carry_out(page: dict[str, Any], request: Request) -> list[Path]:
    """Score the models that are missing, count all, and write the page; `render_only` writes what there is."""
    table = load_table(page["table"])
    models = [row for row in table["rows"] if row["kind"] == "method"]
    rows, facts = score(page, models, request)
    found = [results(row, page["frames"], table["paper"]["humanml3d"]) for row in rows if row.lines]
    section = Section("sizes", found, found, partial(_draw, rows=found), (10.0, 4.5))
    return write_page(page, [section], facts, request.folder(some_config(rows)))


def results(row: TableRow, frames: int, published: dict[str, Any]) -> dict[str, Any]:
    """Return one model: its size, and what it scores."""
    cfg = row.cfg
    if cfg is None:
        raise TypeError(f"row {row.spec['key']!r} describes no model; give it a source and a method")
    store = PackedStore.open(open_corpus(cfg))
    model = untrained(cfg, store, read_motions(store, cfg.scale.protocol.split, 1))
    longest = min(frames, model.max_frames)
    count = operations(model, "a person walks", longest, sampling=build_sampling(cfg), seed=cfg.seed)
    found = {"model": row.spec["label"], "parameters": parameters(model.generator), "GFLOPs": count / 1e9}
    for name, label in METRICS.items():
        value = measure([line["metrics"][name] for line in row.lines])
        if value is not None:
            found |= {label: value.mean, f"{label} ±": value.half}
    return found | {"n": len(row.lines), "paper FID": published[row.spec["key"]]["fid"]}


def _draw(figure: Figure, rows: Rows) -> None:
    """Draw ours beside the paper's, over our operations: the paper's sizes are those of the same labels."""
    if not rows:
        return
    ours, paper = figure.subplots(1, 2, sharex=True)
    _bubbles(ours, rows, "FID", "FID here")
    _bubbles(paper, rows, "paper FID", "FID in the paper (HumanML3D, full size)")


def _bubbles(axes: Axes, rows: Rows, name: str, label: str) -> None:
    largest = max(row["parameters"] for row in rows)
    areas = [AREA * row["parameters"] / largest for row in rows]
    axes.scatter([row["GFLOPs"] for row in rows], [row[name] for row in rows], s=areas, alpha=0.5)
    for row in rows:
        text = f"{row['model'].partition(':')[0]}, {row['parameters'] / 1e6:.3g}M"
        axes.annotate(text, (row["GFLOPs"], row[name]), fontsize=7, ha="center", va="bottom")
    axes.set_xscale("log")
    axes.set_xlabel("GFLOPs for a motion", fontsize=8)
    axes.set_ylabel(label, fontsize=8)
    axes.margins(0.15)
    axes.grid(linewidth=0.4)

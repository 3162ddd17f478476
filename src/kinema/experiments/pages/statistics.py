"""Measure what the corpus alone tells: how its columns look to a diffusion process, and how unequal they are."""

from __future__ import annotations

from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from kinema.data.store import PackedStore
from kinema.diffusion.ddpm import DDPM
from kinema.evaluation.diagnosis.deviations import own_deviations, phi
from kinema.evaluation.diagnosis.groups import by_group
from kinema.evaluation.diagnosis.marginals import marginals
from kinema.experiments.pages.charts import bars
from kinema.experiments.pages.sections import Rows, Section, pivot
from kinema.experiments.pages.subjects import Subject
from kinema.runs.build import build

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AVERAGED, PUBLISHED, OWN, REFORMED, NORMAL = "averaged", "averaged, /25", "own", "AE latents", "N(0, 1) itself"
DRAWN = ("cosine 50", "linear 1000", "scaled linear 1000")


def normalised(store: PackedStore, count: int) -> dict[str, Tensor]:
    """Return a part of the corpus' frames, drawn at random, by how their columns are divided."""
    features = np.asarray(store.features)
    rows = np.sort(np.random.default_rng(0).choice(len(features), min(count, len(features)), replace=False))
    own, averaged = own_deviations(features), store.statistics.std
    ratio = phi(own, store.statistics)
    divisors = {
        AVERAGED: averaged,
        PUBLISHED: store.statistics.published(store.skeleton).std,
        OWN: np.where(np.isnan(ratio), averaged, own),
    }
    centred = features[rows].astype(np.float64) - store.statistics.mean
    return {name: torch.from_numpy((centred / divisor).astype(np.float32)) for name, divisor in divisors.items()}


def distributions(page: dict[str, Any], store: PackedStore, subjects: list[Subject]) -> Section:
    """Measure the marginals of the data and of what the forward process makes of them."""
    data: dict[str, tuple[dict[str, slice], Tensor]] = {
        name: (store.skeleton.groups, values) for name, values in normalised(store, page["frames"]).items()
    }
    for subject in subjects:
        if subject.model.generator.space.kind == "continuous":
            latents, _ = subject.latents()
            values = latents.content[latents.mask].float().cpu()
            data[REFORMED] = (subject.model.tokenizer.groups, values)
            break
    draw = torch.Generator().manual_seed(0)
    rows = _rows(NORMAL, "", "", {"columns": slice(0, 16)}, torch.randn(page["frames"], 16, generator=draw))
    if REFORMED in data:  # fewer rows than frames: a normal sample of that size is farther from N(0, 1)
        groups, values = data[REFORMED]
        rows += _rows(NORMAL, "", "", groups, torch.randn(values.shape, generator=draw))
    for name, (groups, values) in data.items():
        rows += _rows(name, "", "clean", groups, values)
        noise = torch.randn(values.shape, generator=draw)
        for label, spec in page["processes"].items():
            process: DDPM = build(spec)
            last = len(process.schedule.betas) - 1
            for when, time in (("x_T", last), ("half", last // 2)):
                noised = process.add_noise(values, torch.full((len(values),), time), noise)
                rows += _rows(name, label, when, groups, noised)
    shown = pivot(rows, "group", "wasserstein_median", ("divided by", "process", "at"))
    return Section("x_t", rows, shown, partial(_draw_x_t, rows=rows), (10, 7))


def deviations(store: PackedStore) -> Section:
    """Measure phi of every column."""
    own, skeleton = own_deviations(np.asarray(store.features)), store.skeleton
    biased = store.statistics.published(skeleton)
    plain, divided = phi(own, store.statistics), phi(own, biased)
    names = [group for group, columns in skeleton.groups.items() for _ in range(columns.stop - columns.start)]
    rows = [
        {"column": i, "group": names[i], "own": own[i].item(), "averaged": store.statistics.std[i].item()}
        | {"phi": plain[i].item(), "phi /25": divided[i].item()}
        for i in range(len(own))
    ]
    summary, biased_summary = by_group(skeleton.groups, plain, "phi"), by_group(skeleton.groups, divided, "phi /25")
    shown = [
        {"group": group, "columns": names.count(group)}
        | {"constant": int(np.isnan(plain[skeleton.groups[group]]).sum())}
        | summary[group]
        | biased_summary[group]
        for group in skeleton.groups
    ]
    return Section("phi", rows, shown, partial(_draw_phi, rows=rows))


def _rows(name: str, process: str, when: str, groups: dict[str, slice], values: Tensor) -> Rows:
    found = marginals(values)
    parts = {"std": found.std, "wasserstein": found.wasserstein, "kolmogorov": found.kolmogorov}
    summaries = [by_group(groups, value.numpy(), key) for key, value in parts.items()]
    return [
        {"divided by": name, "process": process, "at": when, "group": group}
        | {key: value for summary in summaries for key, value in summary[group].items()}
        for group in groups
    ]


def _draw_x_t(figure: Figure, rows: Rows) -> None:
    floor = next(row["wasserstein_median"] for row in rows if row["divided by"] == NORMAL)
    panels = figure.subplots(2, 1)
    for axes, when in zip(panels, ("clean", "x_T"), strict=True):
        chosen = [row for row in rows if row["at"] == when and row["process"] in ("", *DRAWN)]
        chosen = [row for row in chosen if when == "clean" or row["divided by"] != OWN]
        named = [{**row, "series": f"{row['divided by']} {row['process']}".strip()} for row in chosen]
        bars(axes, named, "group", "wasserstein_median", "series")
        axes.axhline(floor, color="grey", linewidth=0.8, linestyle="--")
        axes.set_ylim(bottom=floor / 2)
        axes.set_title(f"{when}: median distance of columns from N(0, 1) (dashed: a normal sample's)", fontsize=9)


def _draw_phi(figure: Figure, rows: Rows) -> None:
    axes = figure.subplots()
    for key, marker in (("phi", "."), ("phi /25", "x")):
        axes.plot([row["column"] for row in rows], [row[key] for row in rows], marker, markersize=4, label=key)
    axes.axhline(1, color="grey", linewidth=0.8)
    for before, row in pairwise(rows):
        if row["group"] != before["group"]:
            axes.axvline(row["column"] - 0.5, color="lightgrey", linewidth=0.8)
    axes.set(yscale="log", xlabel="column", ylabel="averaged / own deviation")
    axes.legend()

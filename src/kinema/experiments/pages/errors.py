"""Measure what trained runs do: how an error travels, where denoising, samples and reconstructions are wrong."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from kinema.data.store import PackedStore
from kinema.evaluation.diagnosis import amplification as formulas
from kinema.evaluation.diagnosis.deviations import own_deviations
from kinema.evaluation.diagnosis.directions import bands, noise_found, principal
from kinema.evaluation.diagnosis.groups import by_group, shares
from kinema.evaluation.diagnosis.marginals import wasserstein
from kinema.evaluation.diagnosis.probes import Probe, probe
from kinema.experiments.pages.charts import bars, lines
from kinema.experiments.pages.sections import Rows, Section, pivot
from kinema.experiments.pages.subjects import Subject
from kinema.motion import physics
from kinema.motion.recovery import recover_joints
from kinema.tokenizers import MotionTokenizer
from kinema.types import MotionBatch

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FOLLOWED = 16
"""Motions whose samples are drawn again with an error in one output."""


def amplification(page: dict[str, Any], subjects: list[Subject]) -> Section:
    """Hold the formulas against samples drawn with and without an error."""
    rows: Rows = []
    for subject in subjects:
        laid_open = _probe(subject, FOLLOWED)
        process, clean = laid_open.process, laid_open.clean
        table = {
            "in clean": formulas.in_clean(process),
            "in step": formulas.in_step(process),
            "in sample": formulas.in_sample(process),
            "answered": formulas.in_sample(process, 1.0),
        }
        base = process.sample(laid_open.predict, _noise(clean, 1), solver="ancestral")
        wrong = page["error"] * next(_noise(clean, 2))
        for at in timesteps(page, laid_open):
            other = formulas.moved(process, laid_open.predict, _noise(clean, 1), at, wrong)
            measured = _root(laid_open.columns(other - base)) / page["error"]
            row = {"run": subject.label, "predicts": process.prediction, "timestep": at}
            rows.append(row | {name: values[at].item() for name, values in table.items()} | {"measured": measured})
    draw = partial(_panels, rows=rows, ys=("in clean", "in sample", "answered", "measured"))
    return Section("amplification", rows, rows, draw, (11, 3.6))


def denoising(page: dict[str, Any], subjects: list[Subject]) -> Section:
    """Measure the networks' own errors by timestep and group."""
    rows: Rows = []
    for subject in subjects:
        laid_open = _probe(subject)
        noise, groups = next(_noise(laid_open.clean, 3)), subject.model.tokenizer.groups
        for at in timesteps(page, laid_open):
            found = formulas.step_errors(laid_open.process, laid_open.predict, laid_open.clean, at, noise)
            columns = [laid_open.columns(error) for error in found]
            for group, part in groups.items():
                output, clean = (_root(error[:, part]) for error in columns)
                row = {"run": subject.label, "predicts": laid_open.process.prediction, "timestep": at, "group": group}
                rows.append(row | {"output": output, "clean": clean, "ratio": clean / max(output, 1e-12)})
    chosen = [row for row in rows if row["timestep"] in _some(rows, row["run"])]
    shown = pivot(chosen, "group", "clean", ("run", "predicts", "timestep"))
    draw = partial(_panels, rows=rows, ys=("clean",))
    return Section("denoising", rows, shown, draw, (11, 3.6))


def directions(page: dict[str, Any], subjects: list[Subject]) -> Section:
    """Measure how much of the noise the networks find, by timestep and the principal directions of the clean rows."""
    rows: Rows = []
    for subject in subjects:
        laid_open = _probe(subject)
        process, noise = laid_open.process, next(_noise(laid_open.clean, 4))
        clean = laid_open.columns(laid_open.clean)
        variances, axes = principal(clean)
        for at in timesteps(page, laid_open):
            _, error = formulas.step_errors(process, laid_open.predict, laid_open.clean, at, noise)
            implied = -error * process.signal[at] / process.noise[at]  # given x, clean motion implies the noise
            found = noise_found(laid_open.columns(noise), laid_open.columns(implied), axes)
            for band, part in bands(len(axes)).items():
                row = {"run": subject.label, "predicts": process.prediction, "timestep": at, "directions": band}
                share = (variances[part].sum() / variances.sum()).item()
                rows.append(row | {"of the motion": share, "noise found": found[part].mean().item()})
    last = [row for row in rows if row["timestep"] == max(r["timestep"] for r in rows if r["run"] == row["run"])]
    shown = pivot(last, "directions", "noise found", ("run", "predicts", "timestep"))
    most = pivot(last, "directions", "of the motion", ("run",))
    shown = [{"measure": "noise found"} | row for row in shown] + [{"measure": "of the motion"} | row for row in most]

    def draw(figure: Figure) -> None:
        bars(figure.subplots(), last, "directions", "noise found", "run", log=False)

    return Section("directions", rows, shown, draw)


def samples(store: PackedStore, subjects: list[Subject], made: list[MotionBatch]) -> Section:
    """Compare the columns of generated and of real motion."""
    rows: Rows = []
    own = own_deviations(np.asarray(store.features))
    whole = _frames(subjects[0].real)
    compared = {"real halves": (whole[0::2], whole[1::2], subjects[0].model.skeleton.groups)}
    for subject, motions in zip(subjects, made, strict=True):
        compared[subject.label] = (_frames(motions), whole, subject.model.tokenizer.representation.groups)
    summaries: Rows = []
    for label, (ours, real, groups) in compared.items():
        width = ours.shape[1]
        real, scale = real[:, :width], np.where(own[:width] > 0, own[:width], np.nan)
        measures = {
            "shift": np.abs(ours.mean(0) - real.mean(0)) / scale,
            "ratio": ours.std(0) / np.where(real.std(0) > 0, real.std(0), np.nan),
            "wasserstein": wasserstein(ours, real) / scale,
        }
        for group, part in groups.items():
            for column in range(part.start, part.stop):
                values = {name: value[column].item() for name, value in measures.items()}
                rows.append({"run": label, "group": group, "column": column} | values)
        for name, value in measures.items():
            medians = {group: found[f"{name}_median"] for group, found in by_group(groups, value, name).items()}
            summaries += [{"run": label, "measure": name, "group": g, "median": m} for g, m in medians.items()]
    shown = pivot(summaries, "group", "median", ("run", "measure"))
    draw = partial(_bars, rows=[row for row in summaries if row["measure"] == "wasserstein"], y="median")
    return Section("samples", rows, shown, draw)


def jitter(store: PackedStore, subjects: list[Subject], made: list[MotionBatch]) -> Section:
    """Measure the jitter of real and generated joints."""
    skeleton = store.skeleton
    rows: Rows = []
    for label, batch in (("real", subjects[0].real), *((s.label, m) for s, m in zip(subjects, made, strict=True))):
        joints = recover_joints(batch.features, skeleton)
        found = physics.jitter(joints, batch.lengths, skeleton.fps, skeleton.unit)
        quarters = torch.quantile(found.cpu(), torch.tensor([0.25, 0.5, 0.75])).tolist()
        row = {"run": label, "motions": len(found), "jitter": found.mean().item()}
        row |= dict(zip(("quarter", "median", "three quarters"), quarters, strict=True))
        rows.append(row | {"of real": found.mean().item() / rows[0]["jitter"] if rows else 1.0})

    def draw(figure: Figure) -> None:
        bars(figure.subplots(), [{**row, "measure": "jitter"} for row in rows], "run", "jitter", "measure")

    return Section("jitter", rows, rows, draw, (7, 3.4))


@torch.no_grad()
def reconstruction(tokenizers: list[tuple[str, MotionTokenizer]], real: MotionBatch) -> Section:
    """Split the reconstruction loss of tokenizers over the groups."""
    rows: Rows = []
    for label, tokenizer in tokenizers:
        form = tokenizer.representation
        batch = real.to(form.mean.device)
        decoded = tokenizer.decode(tokenizer.encode(batch))
        size = decoded.features.shape[1]
        ours, theirs = (form.normalize(features[:, :size]) for features in (decoded.features, batch.features))
        losses = F.smooth_l1_loss(ours, theirs, reduction="none")[decoded.mask].mean(0).cpu().double().numpy()
        rows += [{"run": label, "group": group} | found for group, found in shares(form.groups, losses).items()]
    draw = partial(_bars, rows=rows, y="share", log=False)
    return Section("reconstruction", rows, rows, draw)


def timesteps(page: dict[str, Any], laid_open: Probe) -> list[int]:
    """Spread the page's number of timesteps over the schedule, both ends included."""
    last = len(laid_open.process.schedule.betas) - 1
    return sorted({round(t) for t in np.linspace(0, last, page["timesteps"]).tolist()} | {max(0, last - 1)})


def _probe(subject: Subject, count: int | None = None) -> Probe:
    latents, text = subject.latents(count)
    return probe(subject.model.generator, latents, text.to(latents.lengths.device))


def _noise(like: Tensor, seed: int) -> Iterator[Tensor]:
    generator = torch.Generator().manual_seed(seed)
    while True:
        yield torch.randn(like.shape, generator=generator).to(like)


def _frames(batch: MotionBatch) -> np.ndarray:
    return batch.features[batch.mask].cpu().double().numpy()


def _root(values: Tensor) -> float:
    return values.cpu().double().square().mean().sqrt().item()


def _some(rows: Rows, run: str) -> set[int]:
    """Choose the first, the middle and the last two timesteps of a run."""
    times = sorted({row["timestep"] for row in rows if row["run"] == run})
    return {times[0], times[len(times) // 2], *times[-2:]}


def _panels(figure: Figure, rows: Rows, ys: tuple[str, ...]) -> None:
    """Draw a panel for each run over the timesteps; a line for each of `ys`, and for each group if rows have one."""
    runs = list(dict.fromkeys(row["run"] for row in rows))
    for axes, run in zip(figure.subplots(1, len(runs), squeeze=False)[0], runs, strict=True):
        chosen = [row for row in rows if row["run"] == run]
        names = list(dict.fromkeys(row.get("group", "") for row in chosen))
        for group in names:
            part = [row for row in chosen if row.get("group", "") == group]
            renamed = [{**row, **{f"{group} {y}".strip(): row[y] for y in ys}} for row in part]
            lines(axes, renamed, "timestep", [f"{group} {y}".strip() for y in ys])
        axes.set_title(run, fontsize=9)


def _bars(figure: Figure, rows: Rows, y: str, log: bool = True) -> None:
    bars(figure.subplots(), rows, "group", y, "run", log=log)

"""Open the dashboards that a configuration asks for, show what is finished, and say where they are."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path

from omegaconf import DictConfig

from kinema.devices import global_rank
from kinema.experiments.config import plain
from kinema.experiments.replications import scored_lines
from kinema.runs.console import console
from kinema.runs.folder import RunFolder
from kinema.training.dashboards import About, Dashboard, check_names, dashboards, kinds
from kinema.training.record import Record

MODES = ("offline", "online")


def check_logger(cfg: DictConfig) -> None:
    """Raise ValueError naming an option of the logger that is wrong."""
    check_names(cfg.logger.names)
    if cfg.logger.mode not in MODES:
        raise ValueError(f"logger.mode={cfg.logger.mode!r}; allowed: {', '.join(MODES)}")


def opened(
    cfg: DictConfig,
    chosen: Sequence[type[Dashboard]],
    folder: Path,
    name: str,
    job_type: str,
    group: str | None = None,
) -> AbstractContextManager[list[Dashboard]]:
    """Open dashboards in a folder, on the first rank alone; `name` ends in what is its own (12 letters)."""
    config = plain(cfg)
    config.pop("hydra", None)
    about = About(
        name,
        project=cfg.logger.project,
        mode=cfg.logger.mode,
        group=group or cfg.logger.group,
        job_type=job_type,
        tags=(cfg.method.name, cfg.data.name, cfg.scale.name),
        config=config,
    )
    return dashboards(chosen if global_rank() == 0 else (), folder, about)


def training_dashboards(cfg: DictConfig, folder: Path, stage: str) -> AbstractContextManager[list[Dashboard]]:
    """Open the dashboards of a run that trains."""
    return opened(cfg, kinds(cfg.logger.names), folder, folder.name, stage)


def show_run(cfg: DictConfig, folder: RunFolder, stage: str) -> None:
    """Say where a finished run's dashboards are; those that it lacks are made of its files."""
    asked = kinds(cfg.logger.names)
    lacking = [kind for kind in asked if kind.where(folder.path) is None]
    if lacking and (folder.path / "metrics.jsonl").exists():
        with folder.lock(), opened(cfg, lacking, folder.path, folder.path.name, stage) as made:
            Record(folder.path, made).replay()
    _tell(asked, folder.path)


def show_results(cfg: DictConfig, folder: RunFolder, *, anew: bool) -> None:
    """Show an evaluation's metrics by replication and its motions; `anew` also where that was done before."""
    asked = [kind for kind in kinds(cfg.logger.names) if kind.takes_results]
    lacking = [kind for kind in asked if anew or kind.where(folder.path) is None]
    if lacking:
        with opened(cfg, lacking, folder.path, folder.path.name, "evaluation") as made:
            _show_results(cfg, folder.path, made)
    _tell(asked, folder.path)


def _show_results(cfg: DictConfig, folder: Path, made: Sequence[Dashboard]) -> None:
    from kinema.experiments.previews import save_films
    from kinema.motion.view.html import save_html
    from kinema.report.motions import read_samples

    record = Record(folder, made)
    motions = read_samples(folder / "samples.npz")
    if motions:
        save_html(motions, record.sample(0, ".html"), cfg.source)
        save_films(motions[: cfg.callbacks.sample_films], record, 0)
    for path in record.samples():
        record.show(path)
    for line in sorted(scored_lines(folder), key=lambda line: line["replication"]):
        for dashboard in made:
            dashboard.scalars(line["replication"], line["metrics"])


def show_table(cfg: DictConfig, name: str, identity: str, written: Sequence[Path]) -> None:
    """Show a rendered table, the published numbers beside ours; its motions are with the evaluations."""
    asked = [kind for kind in kinds(cfg.logger.names) if kind.takes_results]
    if not asked:
        return
    files = {path.name: path for path in written}
    folder = files["table.csv"].parent
    with files["table.csv"].open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    label = f"{name}-{cfg.data.name}-{cfg.scale.name}-s{cfg.seed}-{identity}"
    with opened(cfg, asked, folder, label, "table", name) as made:
        for dashboard in made:
            dashboard.table(name, files["table.md"].read_text(encoding="utf-8"), rows)
    _tell(asked, folder)


def _tell(asked: Sequence[type[Dashboard]], folder: Path) -> None:
    for kind in asked:
        if where := kind.where(folder):
            console.print(f"dashboard {where}")

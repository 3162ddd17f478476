"""Open the dashboards that a configuration asks for, and say where they are."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path

from omegaconf import DictConfig

from kinema.devices import global_rank
from kinema.experiments.config import plain
from kinema.training.dashboards import About, Dashboard, check_names, dashboards, kinds

MODES = ("offline", "online")


def check_logger(cfg: DictConfig) -> None:
    """Raise ValueError naming an option of the logger that is wrong."""
    check_names(cfg.logger.names)
    if cfg.logger.mode not in MODES:
        raise ValueError(f"logger.mode={cfg.logger.mode!r}; allowed: {', '.join(MODES)}")


def shown(cfg: DictConfig, folder: Path, job_type: str) -> AbstractContextManager[list[Dashboard]]:
    """Open the dashboards of a folder: a run's, an evaluation's or a report's; on the first rank alone."""
    config = plain(cfg)
    config.pop("hydra", None)
    about = About(
        folder.name,
        project=cfg.logger.project,
        mode=cfg.logger.mode,
        group=cfg.logger.group,
        job_type=job_type,
        tags=(cfg.method.name, cfg.data.name, cfg.scale.name),
        config=config,
    )
    return dashboards(kinds(cfg.logger.names) if global_rank() == 0 else (), folder, about)

"""Make the loggers of a run: csv, TensorBoard, wandb."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

from omegaconf import DictConfig

from kinema.experiments.config import plain
from kinema.experiments.runs import RunFolder


@contextlib.contextmanager
def loggers(cfg: DictConfig, folder: RunFolder) -> Iterator[list[Any]]:
    """Give the configured loggers and close them, also after a failure (or the next run would log into this one)."""
    from lightning.pytorch.loggers import CSVLogger, TensorBoardLogger, WandbLogger

    made: list[Any] = []
    names = list(cfg.logger.names)
    try:
        for name in names:
            if name == "csv":
                made.append(CSVLogger(folder.path, name="logs", version="csv"))
            elif name == "tensorboard":
                made.append(TensorBoardLogger(folder.path, name="logs", version="tensorboard"))
            elif name == "wandb":
                made.append(
                    WandbLogger(
                        project=cfg.logger.project,
                        name=folder.path.name,
                        id=folder.path.name[-12:],
                        save_dir=folder.path,
                        offline=cfg.logger.mode != "online",
                        config=plain(cfg),
                    )
                )
            else:
                raise ValueError(f"logger.names has {name!r}; allowed: csv, tensorboard, wandb")
        yield made
    finally:
        if "wandb" in names:
            import wandb

            wandb.finish()

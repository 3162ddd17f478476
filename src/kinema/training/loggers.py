"""Make the loggers of a run: csv, TensorBoard, wandb."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

NAMES = ("csv", "tensorboard", "wandb")


def check_names(names: Iterable[str]) -> None:
    """Raise ValueError for an unknown logger."""
    for name in names:
        if name not in NAMES:
            raise ValueError(f"logger.names has {name!r}; allowed: {', '.join(NAMES)}")


@contextlib.contextmanager
def loggers(names: list[str], folder: Path, *, project: str, mode: str, config: dict[str, Any]) -> Iterator[list[Any]]:
    """Return the loggers and close them, also after a failure (or the next run would log into this one)."""
    from lightning.pytorch.loggers import CSVLogger, TensorBoardLogger, WandbLogger

    check_names(names)
    made: list[Any] = []
    try:
        for name in names:
            if name == "csv":
                made.append(CSVLogger(folder, name="logs", version="csv"))
            elif name == "tensorboard":
                made.append(TensorBoardLogger(folder, name="logs", version="tensorboard"))
            else:
                name_and_id: dict[str, Any] = {"name": folder.name, "id": folder.name[-12:]}
                offline = mode != "online"
                made.append(
                    WandbLogger(project=project, save_dir=folder, offline=offline, config=config, **name_and_id)
                )
        yield made
    finally:
        if "wandb" in names:
            import wandb

            wandb.finish()

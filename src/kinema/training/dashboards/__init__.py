"""Show runs, evaluations and tables in dashboards: csv, TensorBoard, wandb."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator
from pathlib import Path

from kinema.training.dashboards.base import About, Dashboard
from kinema.training.dashboards.csv_file import CsvFile
from kinema.training.dashboards.tensorboard import TensorBoard
from kinema.training.dashboards.wandb import Wandb

__all__ = ["NAMES", "About", "Dashboard", "dashboards", "kinds"]

KINDS: tuple[type[Dashboard], ...] = (CsvFile, TensorBoard, Wandb)
NAMES = tuple(kind.name for kind in KINDS)


def kinds(names: Iterable[str]) -> list[type[Dashboard]]:
    """Return the dashboards of these names."""
    known = {kind.name: kind for kind in KINDS}
    return [known[name] for name in names]


@contextlib.contextmanager
def dashboards(chosen: Iterable[type[Dashboard]], folder: Path, about: About) -> Iterator[list[Dashboard]]:
    """Open dashboards and close them, also after a failure (or the next run would be logged into this one)."""
    with contextlib.ExitStack() as stack:
        made = []
        for kind in chosen:
            made.append(kind(folder, about))
            stack.callback(made[-1].close)
        yield made

"""Show a run in Weights & Biases: offline (`wandb sync` later), or online with the user's key."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from kinema.training.dashboards.base import About, Dashboard

MOST_BINS = 512
"""That wandb takes."""


class Wandb(Dashboard):
    """Write one wandb run, whose id is the run's own: a resumed run goes on in it.

    Online, the server has what an earlier part of the run sent, and leaves out steps that it knows.
    """

    name = "wandb"

    def __init__(self, folder: Path, about: About) -> None:
        import wandb

        super().__init__(folder, about)
        self.wandb = wandb
        self.run = wandb.init(
            dir=self.folder.parent,  # it makes a folder `wandb` there
            project=about.project,
            mode="online" if about.mode == "online" else "offline",
            id=about.name[-12:],
            name=about.name,
            group=about.group,
            job_type=about.job_type,
            tags=list(about.tags),
            config=dict(about.config),
            resume="allow" if about.mode == "online" else None,
            reinit="create_new",
            settings=wandb.Settings(console="off", quiet=True),
        )
        if self.run.url:
            (self.folder / "url.txt").write_text(self.run.url)

    @classmethod
    def where(cls, folder: Path) -> str | None:
        """Say the address, or the folder that `wandb sync` takes."""
        address = cls.place(folder) / "url.txt"
        if address.is_file():
            return address.read_text()
        return next((str(run) for run in sorted(cls.place(folder).glob("offline-run-*"))), None)

    def scalars(self, step: int, values: Mapping[str, float]) -> None:
        """Log the numbers."""
        self.run.log(dict(values), step=step)

    def page(self, step: int, name: str, path: Path) -> None:
        """Log the page, which plays there."""
        self.run.log({name: self.wandb.Html(path.read_text(encoding="utf-8"))}, step=step)

    def film(self, step: int, name: str, path: Path) -> None:
        """Log the film."""
        self.run.log({name: self.wandb.Video(str(path), format="mp4")}, step=step)

    def histogram(self, step: int, name: str, counts: np.ndarray) -> None:
        """Log the counts, neighbours together where there are more than wandb takes."""
        width = -(-len(counts) // MOST_BINS)
        starts = np.arange(0, len(counts), width)
        bins = (np.add.reduceat(counts, starts), np.append(starts, len(counts)))
        self.run.log({name: self.wandb.Histogram(np_histogram=bins)}, step=step)

    def table(self, name: str, markdown: str, rows: Sequence[Sequence[str]]) -> None:
        """Log the rows."""
        columns: list[str | int] = [*rows[0]]
        self.run.log({name: self.wandb.Table(columns=columns, data=[list(row) for row in rows[1:]])})

    def artifact(self, files: Sequence[Path]) -> None:
        """Log the files as one model."""
        model = self.wandb.Artifact(self.about.name, type="model")
        for path in files:
            model.add_file(str(path))
        self.run.log_artifact(model)

    def close(self) -> None:
        """End the run."""
        self.run.finish()

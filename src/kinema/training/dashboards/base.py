"""Say what a dashboard takes: numbers and motions by step, tables, and model files."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from kinema.files.json import Each, read_json


@dataclass(frozen=True)
class About:
    """Say whose numbers they are: the run's name, its group (a table), job type (a stage), tags and configuration.

    `project` and `mode` (offline | online) are wandb's.
    """

    name: str
    project: str = "kinema"
    mode: str = "offline"
    group: str | None = None
    job_type: str | None = None
    tags: Sequence[str] = ()
    config: Mapping[str, Any] = field(default_factory=dict)


class Dashboard:
    """Show one run or report, below `logs/NAME` of its folder; a new one replaces what an earlier one left there.

    Subclasses show what they can; this one shows nothing. What is shown is read from the run's own files, so that it
    can be shown again (after a resume, or later).
    `takes_results`: evaluations and tables are shown too, which have files of their own.
    """

    name: ClassVar[str]
    takes_results: ClassVar[bool] = True

    def __init__(self, folder: Path, about: About) -> None:
        self.folder = self.place(folder)
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)
        self.about = about

    @classmethod
    def place(cls, folder: Path) -> Path:
        """Name the folder that it writes below the run's."""
        return folder / "logs" / cls.name

    @classmethod
    def where(cls, folder: Path) -> str | None:
        """Say where the dashboard of a run's folder is; None if it has none."""
        place = cls.place(folder)
        return str(place) if place.is_dir() else None

    def scalars(self, step: int, values: Mapping[str, float]) -> None:
        """Show numbers at a step."""

    def show(self, step: int, name: str, path: Path) -> None:
        """Show a file at a step: a page, a film, or counts by class."""
        if path.suffix == ".json":
            for key, counts in read_json(path, Each(list)).items():
                self.histogram(step, f"{name}/{key}", np.array(counts))
        else:
            {".html": self.page, ".mp4": self.film}[path.suffix](step, name, path)

    def page(self, step: int, name: str, path: Path) -> None:
        """Show a page of players."""

    def film(self, step: int, name: str, path: Path) -> None:
        """Show a film."""

    def histogram(self, step: int, name: str, counts: np.ndarray) -> None:
        """Show counts (k,), one bar each."""

    def table(self, name: str, markdown: str, rows: Sequence[Sequence[str]]) -> None:
        """Show a table, written out and as rows, the first of which has the headings."""

    def artifact(self, files: Sequence[Path]) -> None:
        """Keep files under the run's name."""

    def close(self) -> None:
        """Write what is not yet written."""

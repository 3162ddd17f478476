"""Hand on which jobs of a multirun ended without a result: its launcher tells the process that called the multirun."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kinema.experiments.jobs import Job
from kinema.runs.console import console
from kinema.runs.lines import append_line, read_lines

VARIABLE = "KINEMA_LOST_JOBS"
"""The environment's name for the file that a launcher tells lost jobs in."""

LINE = {"overrides": list, "reason": str}


def tell_lost(overrides: Sequence[str], reason: str) -> None:
    """Tell that the job of some overrides ended without a result, to the user and to who called the multirun."""
    console.print(f"[red]failed[/]    {' '.join(overrides)}: {reason}")
    if path := os.environ.get(VARIABLE):
        append_line(Path(path), {"overrides": list(overrides), "reason": reason})


@dataclass(frozen=True)
class LostJobs:
    """Hold the file in which one multirun's launcher tells what it lost; a process is called with `environment`."""

    path: Path

    @property
    def environment(self) -> dict[str, str]:
        """This process' environment and the file's name."""
        return {**os.environ, VARIABLE: str(self.path)}

    def reasons(self, jobs: Iterable[Job]) -> dict[Job, str]:
        """Return why jobs of the multirun were lost, by the overrides that are their own."""
        lost = [(_values(line["overrides"]), line["reason"]) for line in read_lines(self.path, LINE)]
        own = {job: _values(job.overrides) for job in jobs}
        return {job: reason for job, mine in own.items() for given, reason in lost if mine.items() <= given.items()}


@contextmanager
def lost_jobs() -> Iterator[LostJobs]:
    """Yield a file for one multirun, which is gone afterwards."""
    with tempfile.TemporaryDirectory() as folder:
        yield LostJobs(Path(folder) / "lost.jsonl")


def _values(overrides: Sequence[str]) -> dict[str, Any]:
    """Read overrides as Hydra does, which writes them anew for each job of a sweep."""
    from hydra.core.override_parser.overrides_parser import OverridesParser

    return {found.get_key_element(): found.value() for found in OverridesParser.create().parse_overrides([*overrides])}

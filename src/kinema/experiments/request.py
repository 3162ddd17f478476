"""Hold what `kinema reproduce` is asked for."""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

from omegaconf import DictConfig

from kinema.report.intervals import Form

HERE = "local"
"""The launcher that is none: jobs run in processes of this machine."""

CHOICES = ("launcher=", "hydra/launcher=")
HYDRAS = (*CHOICES, "hydra.", "hydra/")


@dataclass(frozen=True)
class Request:
    """Hold the name of a table or page, the overrides of all its runs, and how to make it.

    `plan` only tells what would run; `render_only` runs nothing; `jobs` processes run side by side on this machine
    (None: one a core of a CPU); `out` is the report's folder. Of tables alone: the form of `intervals`, training
    `seeds` of every method, and how many `replications` of a row one job has (None: all).
    """

    name: str
    overrides: tuple[str, ...] = ()
    render_only: bool = False
    jobs: int | None = None
    out: Path | None = None
    intervals: Form | None = None
    seeds: int = 1
    replications: int | None = None
    plan: bool = False

    def __post_init__(self) -> None:
        for name, value in (("jobs", self.jobs), ("seeds", self.seeds), ("replications-per-job", self.replications)):
            if value is not None and value < 1:
                raise ValueError(f"--{name}={value}; it must be at least 1")

    @property
    def shared(self) -> list[str]:
        """The overrides of every run: all but those of Hydra itself, which say where and how runs are started."""
        return [o for o in self.overrides if not o.lstrip("+").startswith(HYDRAS) or "hydra.searchpath" in o]

    @property
    def launcher(self) -> list[str]:
        """The overrides of Hydra and its launcher; none where jobs run in processes of this machine."""
        own = [o for o in self.overrides if o not in self.shared]
        return own if any(o.startswith(CHOICES) and o != f"launcher={HERE}" for o in own) else []

    @property
    def command(self) -> str:
        """The command that makes the same report, wherever its jobs run."""
        seeds = [] if self.seeds == 1 else ["--seeds", str(self.seeds)]
        form = [] if self.intervals is None else ["--intervals", self.intervals]
        return shlex.join(["kinema", "reproduce", self.name, *self.shared, *seeds, *form])

    def folder(self, cfg: DictConfig | None = None) -> Path:
        """Return the report's folder: of the name, and of the corpus and the scale of a configuration."""
        name = self.name if cfg is None else f"{self.name}-{cfg.data.name}-{cfg.scale.name}"
        return self.out or Path("reports") / re.sub(r"[^\w.+=,-]+", "_", name)

    def refuse_options_of_tables(self) -> None:
        """Raise ValueError naming an option that only tables have."""
        given = {"--intervals": self.intervals is not None, "--seeds": self.seeds != 1}
        for name in (name for name, there in given.items() if there):
            raise ValueError(
                f"{name} is an option of tables; {self.name} is a page, which says how its own are computed"
            )

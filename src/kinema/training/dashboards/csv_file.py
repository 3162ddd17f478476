"""Keep a run's numbers as one CSV file."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

from kinema.training.dashboards.base import About, Dashboard


class CsvFile(Dashboard):
    """Append a line for each step's numbers; a new number makes a new column."""

    name = "csv"
    takes_results = False

    def __init__(self, folder: Path, about: About) -> None:
        super().__init__(folder, about)
        self.columns = ["step"]

    @property
    def path(self) -> Path:
        """Name the file."""
        return self.folder / "metrics.csv"

    def scalars(self, step: int, values: Mapping[str, float]) -> None:
        """Append a line."""
        new = sorted(values.keys() - set(self.columns))
        if new:
            self._widen(new)
        with self.path.open("a", newline="") as file:
            csv.DictWriter(file, self.columns).writerow({"step": step, **values})

    def _widen(self, new: list[str]) -> None:
        """Write the lines anew, with more columns."""
        lines = list(csv.DictReader(self.path.open(newline=""))) if self.path.exists() else []
        self.columns += new
        with self.path.open("w", newline="") as file:
            writer = csv.DictWriter(file, self.columns)
            writer.writeheader()
            writer.writerows(lines)

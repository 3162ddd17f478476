"""Break a table's rows down: by how near a test is to training, and by the fields of the corpus' manifest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from kinema.data.leakage import FRAMES, TAKE
from kinema.experiments.replications import over_seeds

COLUMNS = [
    {"key": "n", "label": "clips", "better": "none", "digits": 0},
    {"key": "r1", "label": "R@1", "better": "higher", "digits": 3},
    {"key": "r3", "label": "R@3", "better": "higher", "digits": 3},
    {"key": "matching", "label": "Matching", "better": "lower", "digits": 3},
]
FID = {"key": "fid", "label": "FID", "better": "lower", "digits": 3}
FEWEST = 512
"""Clips from which a part's FID is shown: as many as an embedding has dims; of fewer the covariance is singular."""

PARTS = (("no shared frames", FRAMES, "none"), ("no shared take", TAKE, "unseen"))
"""What is left of a test without what training has: each a value of a field, the second within the first."""


@dataclass(frozen=True)
class Parts:
    """Hold a row that has results: its description, and its lines by training seed and replication."""

    spec: dict[str, Any]
    seeds: list[list[dict[str, Any]]]

    @property
    def whole(self) -> list[dict[str, float]]:
        """The metrics of the whole test."""
        return over_seeds([[line["metrics"] for line in lines] for lines in self.seeds])

    def values(self, field: str) -> list[str]:
        """Name the values of a field; none where no line knows it."""
        return sorted({value for parts in self._parts(field) for part in parts for value in part})

    def of(self, field: str, value: str) -> list[dict[str, float]]:
        """Return the metrics of a part; a replication without it, or from before the field was known, has none."""
        found = [[part[value] for part in parts if value in part] for parts in self._parts(field)]
        found = [cells for cells in found if cells]
        return over_seeds(found) if found else []

    @property
    def fields(self) -> set[str]:
        """The fields that any line knows."""
        return {name for lines in self.seeds for line in lines for name in line["breakdowns"]}

    def row(self, part: str, results: list[dict[str, float]]) -> dict[str, Any]:
        """Describe a part as a row."""
        row = {"key": f"{self.spec['key']}-{part}", "label": f"{self.spec['label']}: {part}", "kind": self.spec["kind"]}
        seeds = len(self.seeds) if len(self.seeds) > 1 else None
        return {**row, "note": "", "published": None, "results": results, "seeds": seeds}

    def _parts(self, field: str) -> list[list[dict[str, dict[str, float]]]]:
        return [[line["breakdowns"].get(field, {}) for line in lines] for lines in self.seeds]


def breakdowns(shown: list[Parts]) -> list[dict[str, Any]]:
    """Return the tables of parts: the official test beside what of it training has not seen, then field by field."""
    near = _by_nearness(shown)
    return [*([near] if near["rows"] else []), *_by_fields(shown)]


def footnotes(shown: list[Parts]) -> list[str]:
    """Say so where no test clip is of a take that training has: there is then nothing to leave out."""
    found = {value for row in shown for value in row.values(TAKE)}
    return ["No test clip is of a take that training has."] if found == {"unseen"} else []


def _by_nearness(shown: list[Parts]) -> dict[str, Any]:
    """Return every row as published, without shared frames, without shared takes; no row where nothing is shared."""
    rows = []
    for parts in shown:
        if "seen" in parts.values(TAKE):
            rows.append(parts.row("official", parts.whole))
            rows += [parts.row(name, cells) for name, *where in PARTS if (cells := parts.of(*where))]
    for row in rows:
        if min(cell["n"] for cell in row["results"]) < FEWEST:
            row["results"] = [{key: cell[key] for key in cell if key != "fid"} for cell in row["results"]]
    columns = [*COLUMNS, *([FID] if any("fid" in cell for row in rows for cell in row["results"]) else [])]
    return {"title": "Without the frames and takes that training has", "columns": columns, "rows": rows}


def _by_fields(shown: list[Parts]) -> list[dict[str, Any]]:
    """Return one table per field: every row's metrics by the field's values."""
    fields: dict[str, list[dict[str, Any]]] = {}
    for row in shown:
        for name in row.fields - {TAKE, FRAMES}:
            fields.setdefault(name, []).extend(row.row(value, row.of(name, value)) for value in row.values(name))
    return [{"title": f"By {name}", "columns": COLUMNS, "rows": found} for name, found in sorted(fields.items())]

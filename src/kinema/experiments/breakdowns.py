"""Break a table's rows down: by how near a test is to training, and by the fields of the corpus' manifest."""

from __future__ import annotations

from typing import Any

from kinema.data.leakage import FRAMES, TAKE

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

Shown = list[tuple[dict[str, Any], list[dict[str, Any]]]]
"""Rows that have results: their descriptions and their lines by replication."""


def breakdowns(shown: Shown) -> list[dict[str, Any]]:
    """Return the tables of parts: the official test beside what of it training has not seen, then field by field."""
    near = _by_nearness(shown)
    return [*([near] if near["rows"] else []), *_by_fields(shown)]


def footnotes(shown: Shown) -> list[str]:
    """Say so where no test clip is of a take that training has: there is then nothing to leave out."""
    found = {value for _, lines in shown for line in lines for value in line["breakdowns"].get(TAKE, {})}
    return ["No test clip is of a take that training has."] if found == {"unseen"} else []


def _by_nearness(shown: Shown) -> dict[str, Any]:
    """Return every row as published, without shared frames, without shared takes; no row where nothing is shared."""
    rows = []
    for spec, lines in shown:
        if any("seen" in line["breakdowns"].get(TAKE, {}) for line in lines):
            rows.append(_entry(spec, "official", [line["metrics"] for line in lines]))
            rows += [_entry(spec, part, cells) for part, *key in PARTS if (cells := _cells(lines, *key))]
    for row in rows:
        if min(cell["n"] for cell in row["results"]) < FEWEST:
            row["results"] = [{key: cell[key] for key in cell if key != "fid"} for cell in row["results"]]
    columns = [*COLUMNS, *([FID] if any("fid" in cell for row in rows for cell in row["results"]) else [])]
    return {"title": "Without the frames and takes that training has", "columns": columns, "rows": rows}


def _by_fields(shown: Shown) -> list[dict[str, Any]]:
    """Return one table per field: every row's metrics by the field's values."""
    fields: dict[str, list[dict[str, Any]]] = {}
    for spec, lines in shown:
        for name in sorted({name for line in lines for name in line["breakdowns"]} - {TAKE, FRAMES}):
            values = sorted({value for line in lines for value in line["breakdowns"].get(name, {})})
            fields.setdefault(name, []).extend(_entry(spec, value, _cells(lines, name, value)) for value in values)
    return [{"title": f"By {name}", "columns": COLUMNS, "rows": found} for name, found in sorted(fields.items())]


def _cells(lines: list[dict[str, Any]], name: str, value: str) -> list[dict[str, Any]]:
    """Return a part's metrics by replication; a line from before the field was known has none."""
    return [parts[value] for line in lines if value in (parts := line["breakdowns"].get(name, {}))]


def _entry(spec: dict[str, Any], part: str, cells: list[dict[str, Any]]) -> dict[str, Any]:
    """Describe a part of a row as a row."""
    entry = {"key": f"{spec['key']}-{part}", "label": f"{spec['label']}: {part}", "kind": spec["kind"], "note": ""}
    return {**entry, "published": None, "results": cells}

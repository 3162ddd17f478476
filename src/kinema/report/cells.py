"""Turn a table's replications into cells: mean, 95 % interval, the paper's number, and which one is best."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from kinema.report.intervals import FORMS, Form, Value, measure

KINDS = ("real", "control", "method")
FLAG = "†"
ARROWS = {"higher": "↑", "lower": "↓", "real": "→", "none": ""}


@dataclass(frozen=True)
class Cell:
    """Hold what stands in one row and column: ours and the paper's, either may be missing."""

    ours: Value | None
    paper: Value | None
    best: bool = False
    flagged: bool = False


@dataclass(frozen=True)
class Flag:
    """Hold the value above which ours is marked, and what the mark means."""

    above: float
    means: str

    def marks(self, value: Value | None) -> bool:
        """Say whether a value is marked."""
        return value is not None and value.mean > self.above


@dataclass(frozen=True)
class Column:
    """Hold one metric's key, heading and precision; `better` is higher, lower, real (closest to real) or none.

    `flag` marks values that can't be read as the others can.
    """

    key: str
    label: str
    better: str
    digits: int
    flag: Flag | None = None

    @property
    def heading(self) -> str:
        """The label with its arrow."""
        return f"{self.label} {ARROWS[self.better]}".strip()


@dataclass(frozen=True)
class Line:
    """Hold one row, its cells in the order of the columns; what is not `possible` says why in its note.

    With `seeds`, its values are those of so many training seeds, each the mean of its replications.
    """

    key: str
    label: str
    kind: str
    note: str
    replications: int
    implemented: bool
    possible: bool
    seeds: int | None
    cells: tuple[Cell, ...]

    @property
    def state(self) -> str:
        """The number of replications, or say that there is none."""
        if not self.possible:
            return "cannot"
        if not self.implemented:
            return "not in Kinema yet"
        if not self.replications:
            return "not yet run"
        return f"{self.replications} seeds" if self.seeds else str(self.replications)

    @property
    def has_paper(self) -> bool:
        """Say whether the paper has a number for this row."""
        return any(cell.paper for cell in self.cells)


@dataclass(frozen=True)
class Grid:
    """Hold a table ready to be written in any format; `marked`: the best method of a column is."""

    columns: tuple[Column, ...]
    lines: tuple[Line, ...]
    intervals: Form = "student"
    marked: bool = True


def grid(table: dict[str, Any], *, mark_best: bool = False) -> Grid:
    """Compute every cell of a table with `columns` and `rows`; raises ValueError that names what is wrong."""
    columns = tuple(_column(c) for c in table["columns"])
    _refuse_twins([c.key for c in columns], "column")
    _refuse_twins([r["key"] for r in table["rows"]], "row")
    form = table.get("intervals", "student")
    if form not in FORMS:
        raise ValueError(f"intervals={form!r}; allowed: {', '.join(FORMS)}")
    lines = tuple(_line(row, columns, form) for row in table["rows"])
    return Grid(columns, _with_best(columns, lines) if mark_best else lines, form, mark_best)


def _column(spec: dict[str, Any]) -> Column:
    better = spec.get("better") or "none"
    if better not in ARROWS:
        raise ValueError(f"column {spec['key']!r}: better is {better!r}, it should be one of {', '.join(ARROWS)}")
    flag = Flag(**spec["flag"]) if "flag" in spec else None
    return Column(spec["key"], spec.get("label", spec["key"]), better, int(spec.get("digits", 3)), flag)


def _line(row: dict[str, Any], columns: tuple[Column, ...], form: Form) -> Line:
    if row["kind"] not in KINDS:
        raise ValueError(f"row {row['key']!r}: kind is {row['kind']!r}, it should be one of {', '.join(KINDS)}")
    implemented = row.get("results") is not None
    results, published = row.get("results") or [], row.get("published") or {}
    cells = []
    for column in columns:
        found = [float(r[column.key]) for r in results if r.get(column.key) is not None]
        ours, paper = measure(found, form), _published(published.get(column.key))
        ours = ours and replace(ours, fewer=len(found) < len(results))
        cells.append(Cell(ours, paper, flagged=column.flag is not None and column.flag.marks(ours)))
    label = row.get("label", row["key"])
    why = row.get("cannot") or ""
    note = why or row.get("note") or ""
    return Line(
        row["key"], label, row["kind"], note, len(results), implemented, not why, row.get("seeds"), tuple(cells)
    )


def _published(value: Any) -> Value | None:
    """Read a published number: `0.5`, `[0.5, 0.004]` or nothing."""
    if value is None:
        return None
    mean, half = value if isinstance(value, list | tuple) else (value, None)
    return Value(float(mean), None if half is None else float(half))


def _with_best(columns: tuple[Column, ...], lines: tuple[Line, ...]) -> tuple[Line, ...]:
    cells = [list(line.cells) for line in lines]
    for i, column in enumerate(columns):
        best = _best(column, i, lines)
        if best is not None:
            cells[best][i] = replace(cells[best][i], best=True)
    return tuple(replace(line, cells=tuple(c)) for line, c in zip(lines, cells, strict=True))


def _best(column: Column, index: int, lines: tuple[Line, ...]) -> int | None:
    """Find the method whose interval lies apart from every other method's, on the better side."""
    if column.better not in ("higher", "lower"):
        return None
    sign = 1 if column.better == "higher" else -1
    cells = {n: line.cells[index].ours for n, line in enumerate(lines) if line.kind == "method"}
    ours = {n: value for n, value in cells.items() if value is not None}
    spans = {n: (sign * v.mean - v.half, sign * v.mean + v.half) for n, v in ours.items() if v.half is not None}
    if len(ours) < 2 or len(spans) < len(ours):
        return None
    first = max(ours, key=lambda n: sign * ours[n].mean)
    lead, _ = spans[first]
    return first if all(lead > end for n, (_, end) in spans.items() if n != first) else None


def _refuse_twins(keys: list[str], what: str) -> None:
    twins = sorted({key for key in keys if keys.count(key) > 1})
    if twins:
        raise ValueError(f"two {what}s of the table have the key {twins[0]!r}: give each its own")

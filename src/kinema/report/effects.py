"""Hold differences between two rows of a table against the paper's: the same sign, the opposite, or none to be seen."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from typing import Any

from kinema.report.cells import Column, Grid, Line
from kinema.report.escape import spreadsheet
from kinema.report.intervals import Form, Value, measure

HEADINGS = ("effect", "metric", "here", "paper", "")


@dataclass(frozen=True)
class Effect:
    """Hold what one metric of a row has more than another row's; `paper` is the difference of published means.

    Where `ours` is over training seeds, `draws` is over replications, each the mean of these seeds': it holds the
    evaluation's draws alone.
    """

    what: str
    column: Column
    ours: Value | None
    paper: float | None
    draws: Value | None = None

    @property
    def verdict(self) -> str:
        """Say whether the difference has the sign of the paper's; one whose interval holds zero has none."""
        if self.ours is None:
            return "not yet run"
        if self.ours.half is None:
            return "one replication decides nothing"
        if abs(self.ours.mean) <= self.ours.half:
            return "no difference to be seen"
        if self.paper is None:
            return "not in the paper"
        return "as in the paper" if self.ours.mean * self.paper > 0 else "opposite to the paper"

    @property
    def cells(self) -> tuple[str, ...]:
        """Write it under `HEADINGS`."""
        digits = self.column.digits
        ours = "" if self.ours is None else _signed(self.ours.text(digits))
        if self.draws is not None:
            ours += f" (draws: {_signed(self.draws.text(digits))})"
        paper = "" if self.paper is None else _signed(f"{self.paper:.{digits}f}")
        return (self.what, self.column.heading, ours, paper, self.verdict)


def effects(table: dict[str, Any], main: Grid) -> list[Effect]:
    """Compute a table's `effects`: {what, row, than, columns}, rows and columns by key.

    Replications are paired, as their captions, crops and seeds are (docs/evaluation.md). Raises ValueError that names
    a row or column which the table lacks.
    """
    columns = {column.key: (i, column) for i, column in enumerate(main.columns)}
    lines = {line.key: line for line in main.lines}
    results, draws = ({row["key"]: row.get(name) or [] for row in table["rows"]} for name in ("results", "draws"))
    found = []
    for spec in table.get("effects", ()):
        for kind, keys, known in (("row", (spec["row"], spec["than"]), lines), ("column", spec["columns"], columns)):
            for key in keys:
                if key not in known:
                    raise ValueError(f"effect {spec['what']!r}: no {kind} {key!r}; {kind}s: {', '.join(known)}")
        for key in spec["columns"]:
            i, column = columns[key]
            ours, drawn = (
                _difference(key, values[spec["row"]], values[spec["than"]], main.intervals)
                for values in (results, draws)
            )
            paper = _published(lines[spec["row"]], lines[spec["than"]], i)
            found.append(Effect(spec["what"], column, ours, paper, drawn))
    return found


def csv_text(found: list[Effect]) -> str:
    """Write one line per effect."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(["effect", "metric", "difference", "half", "n", "half of draws", "draws", "paper", "verdict"])
    for effect in found:
        ours, draws = effect.ours or Value(float("nan"), None, 0), effect.draws or Value(float("nan"), None)
        found_numbers = (ours.mean, ours.half, ours.count, draws.half, draws.count, effect.paper)
        numbers = ["" if x is None else f"{x:.8g}" for x in found_numbers]
        writer.writerow([spreadsheet(effect.what), spreadsheet(effect.column.key), *numbers, effect.verdict])
    return file.getvalue()


def _difference(key: str, more: list[dict[str, Any]], less: list[dict[str, Any]], form: Form) -> Value | None:
    if len(more) != len(less) or any(row.get(key) is None for row in (*more, *less)):
        return None
    return measure([float(a[key]) - float(b[key]) for a, b in zip(more, less, strict=True)], form)


def _published(more: Line, less: Line, index: int) -> float | None:
    ours, theirs = more.cells[index].paper, less.cells[index].paper
    return None if ours is None or theirs is None else ours.mean - theirs.mean


def _signed(text: str) -> str:
    return text if text.startswith(("-", "not")) else f"+{text}"

"""Work out all that a table's report shows, from what table.json holds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from kinema.report.cells import Grid, grid
from kinema.report.effects import Effect, effects


@dataclass(frozen=True)
class Content:
    """Hold a table as it was given, its cells, those of its breakdowns by title, and its effects."""

    table: dict[str, Any]
    main: Grid
    breakdowns: list[tuple[str, Grid]]
    seen: list[Effect]


def content_of(table: dict[str, Any]) -> Content:
    """Compute the cells of a table; raises ValueError that names what is wrong with it."""
    main = grid(table, mark_best=table.get("mark_best", True))
    parts = [b | {"intervals": main.intervals} for b in table.get("breakdowns", ()) if b["rows"]]
    return Content(table, main, [(part["title"], grid(part)) for part in parts], effects(table, main))

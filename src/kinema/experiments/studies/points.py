"""Score the points of a study: rows like a table's, each computed once, and found again by the next call."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

from kinema.experiments.reproduce import run_missing
from kinema.experiments.tables import TableRow, plan, provenance
from kinema.runs.console import console


def score(
    study: dict[str, Any], points: list[dict[str, Any]], overrides: list[str], *, render_only: bool, jobs: int | None
) -> tuple[list[TableRow], dict[str, Any]]:
    """Return the points' rows, missing ones computed unless `render_only`, and what their results say of themselves.

    `points` are rows as of conf/table; the study's own `overrides` hold for all.
    """
    shared = [o for o in overrides if not o.startswith("launcher=")]
    table = {"rows": points, "overrides": study["overrides"]}
    rows = plan(table, shared)
    if not render_only and not all(row.complete for row in rows):
        run_missing(rows, overrides, study["overrides"], jobs)
        rows = plan(table, shared)
    for row in rows:
        if not row.complete:
            console.print(f"[yellow]empty[/]     no complete results for {row.spec['label']}")
    return rows, provenance(rows, shlex.join(["kinema", "reproduce", study["name"], *shared]))


def folder(study: dict[str, Any], rows: list[TableRow]) -> Path:
    """Return the report's folder: of the study, the corpus and the scale."""
    some = next(row.cfg for row in rows if row.cfg is not None)
    return Path("reports") / f"{study['name']}-{some.data.name}-{some.scale.name}"

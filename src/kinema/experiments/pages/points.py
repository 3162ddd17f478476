"""Score the points of a page: rows like a table's, each computed once, and found again by the next call."""

from __future__ import annotations

from typing import Any

from omegaconf import DictConfig

from kinema.experiments.launching import run_missing
from kinema.experiments.provenance import provenance
from kinema.experiments.request import Request
from kinema.experiments.tables import TableRow, plan
from kinema.runs.console import console


def score(
    page: dict[str, Any], points: list[dict[str, Any]], request: Request
) -> tuple[list[TableRow], dict[str, Any]]:
    """Return the points' rows, missing ones computed, and what their results say of themselves.

    `points` are rows as of conf/table; the page's own `overrides` hold for all.
    """
    table = {"rows": points, "overrides": page["overrides"]}
    rows = plan(table, request.shared)
    if not request.render_only and not all(row.complete for row in rows):
        run_missing(rows, page["overrides"], request)
        rows = plan(table, request.shared)
    for row in rows:
        if not row.complete:
            console.print(f"[yellow]empty[/]     no complete results for {row.spec['label']}")
    return rows, provenance([row.said for row in rows if row.complete], request.command)


def some_config(rows: list[TableRow]) -> DictConfig:
    """Return the configuration of some row: they share corpus and scale."""
    return next(row.cfg for row in rows if row.cfg is not None)

"""Show below a table what stands beside the paper's metrics: the table's own columns, and those of every table."""

from __future__ import annotations

from typing import Any

from omegaconf import OmegaConf

from kinema.experiments.config import CONF, plain


def benchmark_columns() -> list[dict[str, Any]]:
    """Read the columns that every table shows beside its own."""
    return plain(OmegaConf.load(CONF / "benchmark.yaml"))["columns"]


def sections(beside: list[dict[str, Any]], rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a table's own columns beside the paper's, and the benchmark, each with the rows that have any of it."""
    titled = {"Beside the paper's metrics": beside, "Benchmark": benchmark_columns()}
    return [_section(title, columns, rows) for title, columns in titled.items()]


def _section(title: str, columns: list[dict[str, Any]], rows: list[dict[str, Any]]) -> dict[str, Any]:
    keys = {column["key"] for column in columns}
    shown = [{**row, "published": None} for row in rows if any(keys & line.keys() for line in row["results"] or ())]
    return {"title": title, "columns": columns, "rows": shown}

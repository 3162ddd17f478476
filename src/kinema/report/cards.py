"""Say of every run behind a table what it is: a card each, and the limits that a reader must know."""

from __future__ import annotations

import json
from html import escape
from typing import Any

from kinema.report.plots import curves
from kinema.report.text import PAPER_CORPORA

Run = dict[str, Any]
"""A run: name, stage, rows, judge (whether it only judges), facts, config, curves (name: [[step, value], ...])."""


def limits(table: dict[str, Any]) -> list[str]:
    """Return what the numbers of a table can't say."""
    found = []
    corpus, scale = table.get("corpus"), table.get("scale")
    if corpus and corpus not in PAPER_CORPORA:
        found.append(f"The corpus is {corpus}, not the paper's: levels can't be held against published ones.")
    if scale and scale != "paper":
        found.append(f"The scale is {scale}: models are smaller and trained for less than the papers'.")
    seeds = {run["facts"].get("seed") for run in table.get("runs", ()) if not run["judge"]} - {None}
    if len(seeds) == 1:
        found.append(
            f"One training seed ({seeds.pop()}): intervals are over the evaluation's draws, not over trainings."
        )
    counts = [len(row.get("results") or ()) for row in table["rows"]]
    most = max(counts, default=0)
    if 0 < most < 20:
        found.append(f"At most {most} replications a row, where the papers have 20.")
    texts = table.get("provenance", {}).get("text encoder") or []
    if texts and not any("clip" in str(text).lower() for text in texts):
        found.append(f"Captions are read by {', '.join(map(str, texts))}, not by the CLIP of the papers.")
    return found


def run_cards(table: dict[str, Any]) -> str:
    """Return a folded section with a card for each run."""
    runs = table.get("runs", ())
    if not runs:
        return ""
    cards = "\n".join(_card(run) for run in runs)
    return (
        f"<details id='runs'><summary><h2>Runs ({len(runs)})</h2></summary>\n<div class='cards'>\n{cards}\n"
        "</div></details>"
    )


def limits_list(table: dict[str, Any]) -> str:
    """Return the limits as a section."""
    items = "".join(f"<li>{escape(text)}</li>" for text in limits(table))
    return f"<h2 id='limits'>Limits</h2>\n<ul>{items}</ul>" if items else ""


def _card(run: Run) -> str:
    facts = "".join(f"<dt>{escape(key)}</dt><dd>{escape(_text(value))}</dd>" for key, value in run["facts"].items())
    config = escape(json.dumps(run["config"], indent=1))
    rows = ", ".join(run["rows"])
    return (
        f"<article class='card'><h3>{escape(run['name'])}</h3><p class='small'>{escape(run['stage'])}"
        f"{f', behind: {escape(rows)}' if rows else ''}</p>\n{curves(run['curves'])}\n<dl>{facts}</dl>\n"
        f"<details><summary>Configuration</summary><pre>{config}</pre></details></article>"
    )


def _text(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_text(one)}" for key, one in value.items())
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    return f"{value:,}" if isinstance(value, int) else f"{value:.4g}"

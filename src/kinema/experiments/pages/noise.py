"""Score real motion altered by noise of growing level, in essential or redundant dims, under every judge."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kinema.experiments.pages.points import score, some_config
from kinema.experiments.pages.sections import Rows, Section, write_page
from kinema.experiments.request import Request
from kinema.experiments.tables import TableRow
from kinema.report.intervals import measure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

METRICS = {"fid": "FID", "r3": "R@3"}


def carry_out(page: dict[str, Any], request: Request) -> list[Path]:
    """Score the levels that are missing, and write the page; `render_only` writes what there is."""
    rows, facts = score(page, list(points(page)), request)
    found = [results(row) for row in rows if row.lines]
    inches = (4.5 * len(page["judges"]), 6.5)
    section = Section("levels", found, found, partial(_draw, rows=found), inches)
    return write_page(page, [section], facts, request.folder(some_config(rows)))


def points(page: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Return a row for every judge, kind of alteration and level; real motion is the level 0 of all."""
    for judge in page["judges"]:
        chosen, panel = [f"evaluator={judge['evaluator']}"], {"judge": judge["label"]}
        key = judge["label"]
        yield {"key": f"real, {key}", "label": f"real, {key}", "source": "real", "overrides": chosen} | panel
        for how, levels in page["levels"].items():
            for dims in page["dims"]:
                for level in levels:
                    spec = {"dims": dims, "how": how, "level": level, "space": judge["space"]}
                    own = [f"perturb.{name}={value}" for name, value in spec.items()]
                    label = f"{dims} {how} {level}, {key}"
                    row = {"key": label, "label": label, "source": "perturbed", "overrides": [*chosen, *own]}
                    yield row | spec | panel


def results(row: TableRow) -> dict[str, Any]:
    """Return one point."""
    spec, lines = row.spec, [line["metrics"] for line in row.lines]
    found = {key: spec.get(key) for key in ("judge", "dims", "how")} | {"level": spec.get("level", 0.0)}
    for name in METRICS:
        value = measure([metrics[name] for metrics in lines])
        if value is not None:
            found |= {name: value.mean, f"{name} ±": value.half}
    return found | {"n": len(lines)}


def _draw(figure: Figure, rows: Rows) -> None:
    """Draw a column of panels for each judge: FID above, R@3 below; a line for each kind of alteration."""
    judges = list(dict.fromkeys(row["judge"] for row in rows))
    if not judges:
        return
    panels = figure.subplots(len(METRICS), len(judges), squeeze=False, sharey="row", sharex="col")
    for j, judge in enumerate(judges):
        own = [row for row in rows if row["judge"] == judge]
        series = dict.fromkeys((row["dims"], row["how"]) for row in own if row["dims"])
        for axes, name in zip(panels[:, j], METRICS, strict=True):
            for dims, how in series:
                line = sorted((r for r in own if (r["dims"], r["how"]) == (dims, how)), key=lambda row: row["level"])
                axes.errorbar(
                    [row["level"] for row in line],
                    [row[name] for row in line],
                    yerr=[row[f"{name} ±"] or 0 for row in line],
                    color="tab:orange" if dims == "redundant" else "tab:blue",
                    linestyle="-" if how == "add" else "--",
                    marker=".",
                    capsize=2,
                    label=f"{dims}, {how}",
                )
            for row in own:
                if row["dims"] is None and name != "fid":
                    axes.axhline(row[name], color="grey", linewidth=0.8, linestyle=":", label="real")
            axes.set_xscale("log")
            # Linear below 0.01: an evaluator that doesn't read the dims has FID 0.
            axes.set_yscale("symlog", linthresh=0.01) if name == "fid" else axes.set_yscale("linear")
            axes.grid(linewidth=0.4)
        panels[0, j].set_title(judge, fontsize=10)
        panels[-1, j].set_xlabel("level of noise (standard deviations)", fontsize=8)
    panels[-1, 0].legend(fontsize=7)
    for axes, label in zip(panels[:, 0], METRICS.values(), strict=True):
        axes.set_ylabel(label)

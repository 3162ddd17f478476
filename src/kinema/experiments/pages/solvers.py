"""Score every method with every solver on the validation split, and draw quality against network evaluations."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
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

DEFAULT = "default"
QUALITIES = {"fid": "FID", "r3": "R@3"}
COUNTS = {"denoiser_rows": "rows", "denoiser_calls": "calls", "transformer_rows": "transformer rows"}
CHOSEN = ("solver", "steps", "grid", "guided")
SHOWN = ("method", *CHOSEN, "rows", "calls", "transformer rows", "fid", "fid ±", "r3", "r3 ±", "n", "fast")


@dataclass(frozen=True)
class Choice:
    """Hold what a point changes of a method's sampling: nothing of it is the method's default.

    `steps` None are the solver's own; `grid` None is the method's, `interval` where guidance acts.
    """

    solver: str = DEFAULT
    steps: int | str | None = None
    grid: str | None = None
    interval: tuple[float, float] | None = None

    @property
    def words(self) -> list[str]:
        """Name it, as keys and labels do."""
        told = (self.solver, self.steps, self.grid, self.guided)
        return [str(word) for word in told if word]

    @property
    def guided(self) -> str | None:
        """Say where guidance acts."""
        return None if self.interval is None else "guided {:g} to {:g}".format(*self.interval)

    @property
    def overrides(self) -> list[str]:
        """The overrides that make it; a method's file need not have the keys of grid and interval."""
        at, found = "generator.sampling.", []
        if self.solver != DEFAULT:
            steps = "null" if self.steps is None else self.steps
            found += [f"{at}solver={self.solver}", f"{at}solver_steps={steps}"]
        found += [f"++{at}solver_grid={self.grid}"] if self.grid else []
        return found + ([f"++{at}guidance_interval={list(self.interval)}"] if self.interval else [])


def carry_out(page: dict[str, Any], request: Request) -> list[Path]:
    """Score the points that are missing, and write the page; `render_only` writes what there is."""
    rows, facts = score(page, list(points(page)), request)
    found = [results(row) for row in rows if row.lines]
    for method in page["methods"]:
        mark_fast([row for row in found if row["method"] == method["label"]])
    shown = [{key: row.get(key) for key in SHOWN} for row in found]
    section = Section("solvers", found, shown, partial(_draw, rows=found), (4 * len(page["methods"]) + 1, 6.5))
    facts.pop("sampling", None)  # the points say it
    return write_page(page, [section], facts, request.folder(some_config(rows)))


def points(page: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Return a table's row for real motion, and for every method with its default and each choice of its sampler.

    That is each solver (on each grid) with each number of steps, and the default with guidance in each of the method's
    `intervals` alone.
    """
    yield {"key": "real", "label": "Real motion", "of": "Real motion", "source": "real"}
    for spec in page["methods"]:
        for chosen in (Choice(), *_choices(spec, page["solvers"][spec["solvers"]])):
            row: dict[str, Any] = {
                "key": "-".join((spec["key"], *chosen.words)).replace(" ", "-"),
                "label": " ".join((spec["label"], *chosen.words)),
            }
            row |= {"of": spec["label"], "source": "generation", "method": spec["method"]}
            row |= {name: getattr(chosen, name) for name in CHOSEN}
            yield row | {"overrides": [*spec.get("overrides", []), *chosen.overrides]}


def _choices(spec: dict[str, Any], solvers: dict[str, list[int | str | None]]) -> Iterator[Choice]:
    for name, counts in solvers.items():
        solver, _, grid = name.partition(" ")
        yield from (Choice(solver, steps, grid or None) for steps in counts)
    yield from (Choice(interval=tuple(interval)) for interval in spec.get("intervals", ()))


def results(row: TableRow) -> dict[str, Any]:
    """Return one point: what it costs and how good it is."""
    spec, lines = row.spec, [line["metrics"] for line in row.lines]
    found = {"key": spec["key"], "method": spec["of"], "solver": spec.get("solver", DEFAULT)}
    found |= {name: spec.get(name) for name in CHOSEN[1:]} | {"n": len(lines)}
    for name, shown in COUNTS.items():
        counted = [metrics[name] for metrics in lines if name in metrics]
        found[shown] = sum(counted) / len(counted) if counted else None
    for name in QUALITIES:
        # Of two replications Student's t is so wide that every point would be within it.
        value = measure([metrics[name] for metrics in lines], "published")
        if value is not None:
            found |= {name: value.mean, f"{name} ±": value.half}
    return found


def mark_fast(rows: Rows) -> None:
    """Mark the row of fewest network rows whose FID is within the interval of the best.

    Points that lack a replication are no candidates: replications differ by more than solvers do. Nor are results from
    before rows were counted.
    """
    most = max((row["n"] for row in rows), default=0)
    rows = [row for row in rows if row["n"] == most and row["rows"] is not None]
    if not rows:
        return
    best = min(rows, key=lambda row: row["fid"])
    within = [row for row in rows if row["fid"] <= best["fid"] + (best["fid ±"] or 0.0)]
    min(within, key=lambda row: row["rows"])["fast"] = "fast"


def _draw(figure: Figure, rows: Rows) -> None:
    """Draw a column of panels for each method: FID above, R@3 below; a line for each solver."""
    real = next((row for row in rows if row["key"] == "real"), None)
    rows = [row for row in rows if row["rows"] is not None]
    methods = list(dict.fromkeys(row["method"] for row in rows))
    if not methods:
        return
    panels = figure.subplots(len(QUALITIES), len(methods), squeeze=False, sharey="row", sharex="col")
    for j, method in enumerate(methods):
        for axes, name in zip(panels[:, j], QUALITIES, strict=True):
            own = [row for row in rows if row["method"] == method]
            for solver in dict.fromkeys(_series(row) for row in own):
                line = sorted((row for row in own if _series(row) == solver), key=lambda row: row["rows"])
                x, y = [row["rows"] for row in line], [row[name] for row in line]
                axes.errorbar(x, y, yerr=[row[f"{name} ±"] or 0 for row in line], marker=".", capsize=2, label=solver)
            for row in own:
                if row.get("fast"):
                    axes.plot(row["rows"], row[name], "o", markersize=10, fillstyle="none", color="black", label="fast")
            if real is not None and name != "fid":
                axes.axhline(real[name], color="grey", linewidth=0.8, linestyle="--", label="real")
            axes.set_xscale("log")
            axes.set_yscale("log" if name == "fid" else "linear")
            axes.grid(linewidth=0.4)
        panels[0, j].set_title(method, fontsize=10)
        panels[0, j].legend(fontsize=7)
        panels[-1, j].set_xlabel("network rows for a motion", fontsize=8)
    for axes, label in zip(panels[:, 0], QUALITIES.values(), strict=True):
        axes.set_ylabel(label)


def _series(row: dict[str, Any]) -> str:
    """Name the line of a point: its solver and grid, those of leading timesteps and of guided intervals apart."""
    leading = "leading" if str(row["steps"]).startswith("leading") else None
    return " ".join(word for word in (row["solver"], leading, row["grid"], row["guided"]) if word)

"""Draw rows: bars by group, and lines over a number."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from kinema.experiments.pages.sections import Rows

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def bars(axes: Axes, rows: Rows, x: str, y: str, series: str, *, log: bool = True) -> None:
    """Draw a bar of each row's `y`: those of one `x` together, a colour for each of `series`."""
    places = list(dict.fromkeys(row[x] for row in rows))
    names = list(dict.fromkeys(row[series] for row in rows))
    width = 0.8 / len(names)
    for i, name in enumerate(names):
        chosen = [row for row in rows if row[series] == name]
        at = [places.index(row[x]) + (i - (len(names) - 1) / 2) * width for row in chosen]
        axes.bar(at, [row[y] for row in chosen], width, label=name)
    axes.set_xticks(range(len(places)), places, fontsize=8)
    _finish(axes, y, log)
    axes.legend(fontsize=7, loc="lower left", bbox_to_anchor=(0, 1), ncols=len(names), frameon=False)  # no bar hidden


def lines(axes: Axes, rows: Rows, x: str, ys: Sequence[str], *, log: bool = True) -> None:
    """Draw each of `ys` over `x`, in the rows' order."""
    for y in ys:
        chosen = [row for row in rows if row.get(y) is not None and (row[y] > 0 or not log)]
        axes.plot([row[x] for row in chosen], [row[y] for row in chosen], marker=".", label=y)
    axes.set_xlabel(x)
    _finish(axes, "", log)


def _finish(axes: Axes, y: str, log: bool) -> None:
    if log:
        axes.set_yscale("log")
    axes.set_ylabel(y, fontsize=8)
    axes.grid(axis="y", linewidth=0.4)
    axes.legend(fontsize=7)

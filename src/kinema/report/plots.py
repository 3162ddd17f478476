"""Draw a report's plots as SVG, coloured by the page's style: metrics with their intervals, and training curves."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape

from kinema.report.cells import Column, Grid, Line
from kinema.report.intervals import Value

_WIDE, _LEFT, _RIGHT, _ROW = 480, 168, 14, 21
_FAR, _NOTHING = 30, 1e-5
"""The ratio of the largest to the smallest value from which an axis is logarithmic; that which counts as zero."""


@dataclass(frozen=True)
class Axis:
    """Map numbers to pixels between `start` and `end`; on a logarithmic axis zero lies at its start."""

    low: float
    high: float
    start: float
    end: float
    log: bool = False

    @classmethod
    def over(cls, values: Sequence[float], start: float, end: float, *, log: bool = False) -> Axis:
        """Span some numbers with a margin; `log`: logarithmically if they are far apart and none is negative."""
        low, high = min(values), max(values)
        least = min((v for v in values if v > _NOTHING * high), default=high)
        if log and low >= 0 and high > _FAR * least:
            return cls(math.log10(least) - 0.08, math.log10(high) + 0.08, start, end, log=True)
        margin = 0.06 * (high - low) or 0.1 * abs(high) or 1.0
        return cls(low - margin, high + margin, start, end)

    def __call__(self, value: float) -> float:
        if self.log:
            value = math.log10(value) if value > 0 else self.low
        share = (min(max(value, self.low), self.high) - self.low) / (self.high - self.low)
        return round(self.start + share * (self.end - self.start), 1)

    @property
    def ticks(self) -> list[float]:
        """Return a few round numbers within."""
        if self.log:
            decades = range(math.ceil(self.low), math.floor(self.high) + 1)
            return [10.0**d for d in decades] or [10 ** ((self.low + self.high) / 2)]
        rough = (self.high - self.low) / 4
        unit = 10 ** math.floor(math.log10(rough))
        step = next(m * unit for m in (1, 2, 5, 10) if m * unit >= rough)
        first = math.ceil(self.low / step)
        return [n * step for n in range(first, math.floor(self.high / step) + 1)]


def metric_plots(content: Grid) -> list[str]:
    """Return a figure for each column that has numbers of two rows or more."""
    return [plot for i, column in enumerate(content.columns) if (plot := _metric(content, i, column))]


def _metric(content: Grid, index: int, column: Column) -> str:
    rows = [(line, line.cells[index].ours, line.cells[index].paper) for line in content.lines]
    rows = [(line, _finite(ours), _finite(paper)) for line, ours, paper in rows]
    rows = [row for row in rows if row[1] or row[2]]
    if len(rows) < 2:
        return ""
    values = [value.mean for _, *pair in rows for value in pair if value]
    axis = Axis.over(values, _LEFT, _WIDE - _RIGHT, log=column.better != "higher")  # those are shares and scores
    height = len(rows) * _ROW + 8
    parts = [*_vertical(axis, 4, height), *(_row(axis, 4 + (n + 0.5) * _ROW, *row) for n, row in enumerate(rows))]
    title = f"{column.heading}{', logarithmic' if axis.log else ''}"
    return _figure(title, _svg(_WIDE, height + 18, f"{column.label}: ours and the paper's, by row", parts))


def _row(axis: Axis, y: float, line: Line, ours: Value | None, paper: Value | None) -> str:
    label = line.label if len(line.label) <= 28 else f"{line.label[:27]}…"
    text = f"<text class='name' x='{_LEFT - 8}' y='{y + 4:g}'>{escape(label)}</text>"
    marks = [f"<g class='{line.kind}'><title>{escape(line.label)}</title>{text}"]
    if paper:
        x = axis(paper.mean)
        diamond = f"<path d='M{x} {y + 0.5:g}l4.5 4.5l-4.5 4.5l-4.5 -4.5z'/>"
        marks.append(f"<g class='paper'>{_whisker(axis, paper, y + 5)}{diamond}</g>")
    if ours:
        marks.append(
            f"<g class='ours'>{_whisker(axis, ours, y - 2)}<circle cx='{axis(ours.mean)}' cy='{y - 2:g}' r='4'/></g>"
        )
    return "".join([*marks, "</g>"])


def _whisker(axis: Axis, value: Value, y: float) -> str:
    if value.half is None:
        return ""
    low, high = axis(value.mean - value.half), axis(value.mean + value.half)
    return f"<path class='whisker' d='M{low} {y - 3:g}v6M{low} {y:g}H{high}M{high} {y - 3:g}v6'/>"


def curves(lines: dict[str, Sequence[Sequence[float]]]) -> str:
    """Draw (step, value) points of a run's losses: one line each, on one axis."""
    found = {name: [(x, y) for x, y in points if math.isfinite(y)] for name, points in lines.items()}
    found = {name: points for name, points in found.items() if points}
    if not found:
        return ""
    across = Axis(0, max(x for points in found.values() for x, _ in points) or 1, 46, 306)
    up = Axis.over([y for points in found.values() for _, y in points], 118, 8, log=True)
    parts = [*_horizontal(up, 46, 306)]
    for tick in (0.0, across.high):
        parts.append(f"<text class='tick' x='{across(tick)}' y='134'>{_number(tick)}</text>")
    for name, points in found.items():
        kind = "val" if name.startswith("val") else "train"
        path = " ".join(f"{across(x)},{up(y)}" for x, y in points)
        dots = [f"<circle cx='{across(x)}' cy='{up(y)}' r='2.5'/>" for x, y in points if kind == "val"]
        parts.append(f"<g class='{kind}'><title>{escape(name)}</title><polyline points='{path}'/>{''.join(dots)}</g>")
    names = " · ".join(f"<b class='{'val' if n.startswith('val') else 'train'}'>{escape(n)}</b>" for n in found)
    return _figure(f"{names} by step", _svg(320, 138, f"{', '.join(found)} by step", parts), raw=True)


def _vertical(axis: Axis, top: float, bottom: float) -> Iterable[str]:
    for tick in axis.ticks:
        x = axis(tick)
        yield f"<path class='grid' d='M{x} {top}V{bottom}'/>"
        yield f"<text class='tick' x='{x}' y='{bottom + 14}'>{_number(tick)}</text>"


def _horizontal(axis: Axis, left: float, right: float) -> Iterable[str]:
    for tick in axis.ticks:
        y = axis(tick)
        yield f"<path class='grid' d='M{left} {y}H{right}'/>"
        yield f"<text class='side' x='{left - 5}' y='{y + 4}'>{_number(tick)}</text>"


def _finite(value: Value | None) -> Value | None:
    return value if value is not None and math.isfinite(value.mean) else None


def _number(value: float) -> str:
    return f"{round(value, 10):g}" if abs(value) < 1e5 else f"{value:.0e}"


def _svg(width: int, height: float, label: str, parts: Iterable[str]) -> str:
    return f"<svg viewBox='0 0 {width} {height:g}' role='img' aria-label='{escape(label)}'>{''.join(parts)}</svg>"


def _figure(caption: str, svg: str, raw: bool = False) -> str:
    return f"<figure class='plot'><figcaption>{caption if raw else escape(caption)}</figcaption>{svg}</figure>"

"""Write a report as one self-contained web page: the tables, where they come from, and the motions themselves."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from importlib import resources
from typing import TYPE_CHECKING, Any

from kinema.motion.view.html import page, viewer_fragment
from kinema.report.cells import FLAG, Cell, Column, Grid, Line
from kinema.report.effects import HEADINGS, Effect
from kinema.report.text import EFFECTS, effects_legend, flags_legend, flatten, legend, notice, unfinished

if TYPE_CHECKING:
    from kinema.types import Motion

_FOLD = 12  # a breakdown of more rows starts folded


def html_page(
    table: dict[str, Any],
    main: Grid,
    breakdowns: list[tuple[str, Grid]],
    seen: Sequence[Effect],
    motions: dict[str, list[Motion]],
) -> str:
    """Return the whole document."""
    tone = "good" if table.get("comparable") else "warn"
    parts = [
        f"<header class='kinema-page-head'><h1>{escape(table['title'])}</h1></header>",
        f"<p class='notice {tone}'>{escape(notice(table))}</p>",
        _table(main),
        f"<p class='small'>{escape(legend(main))} Grey, marked: the paper's.</p>",
        _flags(main),
        _notes(table, main),
        _effects(main, seen),
        _motions(main, motions),
        *(_breakdown(title, content) for title, content in breakdowns),
        _provenance(table),
    ]
    style = resources.files("kinema.report").joinpath("report.css").read_text(encoding="utf-8")
    return page(table["title"], "<main class='kinema-page'>\n" + "\n".join(filter(None, parts)) + "\n</main>", style)


def _table(content: Grid) -> str:
    heads = "".join(f"<th scope='col'>{escape(c.heading)}</th>" for c in content.columns)
    rows, kind = [], None
    for line in content.lines:
        rows.append(_row(content, line, opens=kind not in (None, line.kind)))
        kind = line.kind
    body = "\n".join(rows)
    return (
        f"<div class='scroll'><table>\n<thead><tr><th scope='col'></th><th scope='col'>n</th>{heads}</tr></thead>\n"
        f"<tbody>\n{body}\n</tbody></table></div>"
    )


def _row(content: Grid, line: Line, opens: bool) -> str:
    classes = " ".join(filter(None, [line.kind, "opens" if opens else "", "" if line.replications else "idle"]))
    remarks = [line.note] if line.replications else [line.state, line.note]
    small = "".join(f"<small>{escape(remark)}</small>" for remark in remarks if remark)
    count = line.state if line.replications else ""
    cells = "".join(_cell(column, cell, line) for column, cell in zip(content.columns, line.cells, strict=True))
    return f"<tr class='{classes}'><th scope='row'>{escape(line.label)}{small}</th><td>{count}</td>{cells}</tr>"


def _cell(column: Column, cell: Cell, line: Line) -> str:
    ours = _value(cell.ours.text(column.digits)) if cell.ours else "–" if line.replications else "&nbsp;"
    if cell.flagged and column.flag:
        ours += f"<sup title='{escape(column.flag.means, quote=True)}'>{FLAG}</sup>"
    best = " class='best'" if cell.best else ""
    paper = f"<span class='paper'>{_value(cell.paper.text(column.digits))}</span>" if cell.paper else ""
    return f"<td><span{best}>{ours}</span>{paper}</td>"


def _value(text: str) -> str:
    mean, _, half = text.partition(" ± ")
    return f"{mean}<i> ± {half}</i>" if half else mean


def _flags(content: Grid) -> str:
    text = flags_legend(content)
    return f"<p class='small'>{escape(text)}</p>" if text else ""


def _notes(table: dict[str, Any], main: Grid) -> str:
    notes = [*table.get("footnotes", ()), *unfinished(main)]
    items = "".join(f"<li>{escape(str(note))}</li>" for note in notes)
    return f"<ul class='small'>{items}</ul>" if items else ""


def _effects(main: Grid, seen: Sequence[Effect]) -> str:
    if not seen:
        return ""
    heads = "".join(f"<th scope='col'>{escape(heading)}</th>" for heading in HEADINGS)
    rows = []
    for effect in seen:
        what, metric, ours, paper, verdict = effect.cells
        cells = (escape(metric), _value(ours), escape(paper), escape(verdict))
        rows.append(
            f"<tr><th scope='row'>{escape(what)}</th>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>"
        )
    body = "\n".join(rows)
    return (
        f"<h2>{EFFECTS}</h2>\n<div class='scroll'><table>\n<thead><tr>{heads}</tr></thead>\n<tbody>\n{body}\n"
        f"</tbody></table></div>\n<p class='small'>{escape(effects_legend(main))}</p>"
    )


def _breakdown(title: str, content: Grid) -> str:
    state = "" if len(content.lines) > _FOLD else " open"
    return f"<details{state}><summary><h2>{escape(title)}</h2></summary>\n{_table(content)}{_flags(content)}</details>"


def _motions(main: Grid, motions: dict[str, list[Motion]]) -> str:
    """Show the motions prompt by prompt, one player per row; row by row where rows share no prompt."""
    labels = {line.key: line.label for line in main.lines}
    shown = [(key, motion) for key in labels for motion in motions.get(key, ())]
    if not shown:
        return ""
    rows_of: dict[str, set[str]] = {}
    for key, motion in shown:
        rows_of.setdefault(motion.text, set()).add(key)
    head = "<h2>Motions</h2>\n"
    if not any(len(keys) > 1 for keys in rows_of.values()):
        players = viewer_fragment([m for _, m in shown], groups=[labels[key] for key, _ in shown])
        return head + players
    prompts = list(rows_of)
    shown.sort(key=lambda item: prompts.index(item[1].text))  # stable: rows keep their order within a prompt
    groups = [motion.text for _, motion in shown]
    return head + viewer_fragment([m for _, m in shown], labels=[labels[key] for key, _ in shown], groups=groups)


def _provenance(table: dict[str, Any]) -> str:
    facts = flatten(table.get("provenance", {}))
    if not facts:
        return ""
    lines = "\n".join(f"<dt>{escape(key)}</dt><dd>{escape(value)}</dd>" for key, value in facts)
    return f"<h2>Provenance</h2>\n<dl>\n{lines}\n</dl>"

"""Write a report as a web page: the tables and plots, where they come from, and the motions, read when looked at."""

from __future__ import annotations

from html import escape
from typing import Any

from kinema.motion.view.html import page, viewer_script, viewer_style
from kinema.report.assets import asset
from kinema.report.cards import limits_list, run_cards
from kinema.report.cells import FLAG, Cell, Column, Grid, Line
from kinema.report.content import Content
from kinema.report.effects import HEADINGS
from kinema.report.gallery import gallery, gallery_script, group_of
from kinema.report.plots import metric_plots
from kinema.report.text import EFFECTS, effects_legend, flags_legend, flatten, legend, notice, unfinished

_MARKS = ("Limits", "Plots", "Motions", "Runs", "Provenance")  # parts that the navigation leads to
_FOLD = 12  # a breakdown of more rows starts folded


def html_page(content: Content, home: str | None = None) -> str:
    """Return the whole document; `home` is the address of the site's first page, seen from here."""
    table, main = content.table, content.main
    tone = "good" if table.get("comparable") else "warn"
    group = group_of(table)
    parts = [
        f"<header class='kinema-page-head'><h1>{escape(table['title'])}</h1></header>",
        f"<p class='notice {tone}'>{escape(notice(table))}</p>",
        _table(main),
        f"<p class='small'>{escape(legend(main))} Grey, marked: the paper's.</p>",
        _flags(main),
        _notes(table, main),
        _effects(content),
        limits_list(table),
        _plots(main),
        gallery([group]) if group else "",
        *(_breakdown(title, part) for title, part in content.breakdowns),
        run_cards(table),
        provenance_list(table.get("provenance", {})),
    ]
    return document(table["title"], parts, home)


def document(title: str, parts: list[str], home: str | None = None) -> str:
    """Put the parts of a page together: navigation, styles, and the scripts that sort and play."""
    shown = list(filter(None, parts))
    marks = [(word, f"#{word.lower()}") for word in _MARKS if any(f"id='{word.lower()}'" in part for part in shown)]
    links = [*([("All results", home)] if home is not None else []), *marks]
    if links:
        items = " ".join(f"<a href='{escape(target)}'>{escape(word)}</a>" for word, target in links)
        shown.insert(0, f"<nav>{items}</nav>")
    style = asset("report.css") + viewer_style() + asset("gallery.css")
    script = asset("sort.js")
    if any("kinema-gallery" in part for part in shown):
        script += viewer_script() + gallery_script()
    body = "<main class='kinema-page'>\n" + "\n".join(shown) + "\n</main>"
    return page(title, body, style, script)


def _table(content: Grid) -> str:
    heads = "".join(
        f"<th scope='col' data-better='{escape(c.better)}'>{escape(c.heading)}</th>" for c in content.columns
    )
    rows, kind = [], None
    for line in content.lines:
        rows.append(_row(content, line, opens=kind not in (None, line.kind)))
        kind = line.kind
    body = "\n".join(rows)
    papers = any(line.has_paper for line in content.lines)
    choice = "<caption><label hidden><input type='checkbox'> sort by the paper's numbers</label></caption>\n"
    return (
        f"<div class='scroll' tabindex='0'><table class='sortable'>\n{choice if papers else ''}"
        f"<thead><tr><th scope='col'></th><th scope='col'>n</th>{heads}</tr></thead>\n"
        f"<tbody>\n{body}\n</tbody></table></div>"
    )


def _row(content: Grid, line: Line, opens: bool) -> str:
    classes = " ".join(filter(None, [line.kind, "opens" if opens else "", "" if line.replications else "idle"]))
    remarks = [line.note] if line.replications else [line.state, line.note]
    small = "".join(f"<small>{escape(remark)}</small>" for remark in remarks if remark)
    count = line.state if line.replications else ""
    cells = "".join(_cell(column, cell, line) for column, cell in zip(content.columns, line.cells, strict=True))
    return (
        f"<tr class='{classes}'><th scope='row'>{escape(line.label)}{small}</th><td data-ours='{count}'>{count}</td>"
        f"{cells}</tr>"
    )


def _cell(column: Column, cell: Cell, line: Line) -> str:
    ours = _value(cell.ours.text(column.digits)) if cell.ours else "–" if line.replications else "&nbsp;"
    if cell.flagged and column.flag:
        ours += f"<sup title='{escape(column.flag.means, quote=True)}'>{FLAG}</sup>"
    best = " class='best'" if cell.best else ""
    paper = f"<span class='paper'>{_value(cell.paper.text(column.digits))}</span>" if cell.paper else ""
    numbers = "".join(
        f" data-{name}='{value.mean:.8g}'" if value else f" data-{name}=''"
        for name, value in (("ours", cell.ours), ("paper", cell.paper))
    )
    return f"<td{numbers}><span{best}>{ours}</span>{paper}</td>"


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


def _effects(content: Content) -> str:
    if not content.seen:
        return ""
    heads = "".join(f"<th scope='col'>{escape(heading)}</th>" for heading in HEADINGS)
    rows = []
    for effect in content.seen:
        what, metric, ours, paper, verdict = effect.cells
        cells = (escape(metric), _value(ours), escape(paper), escape(verdict))
        rows.append(
            f"<tr><th scope='row'>{escape(what)}</th>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>"
        )
    body = "\n".join(rows)
    return (
        f"<h2>{EFFECTS}</h2>\n<div class='scroll'><table>\n<thead><tr>{heads}</tr></thead>\n<tbody>\n{body}\n"
        f"</tbody></table></div>\n<p class='small'>{escape(effects_legend(content.main))}</p>"
    )


def _plots(main: Grid) -> str:
    plots = metric_plots(main)
    if not plots:
        return ""
    key = "<p class='small'>Filled: ours, with its 95 % interval; hollow: the paper's. Rows as in the table.</p>"
    return f"<h2 id='plots'>Plots</h2>\n{key}\n<div class='plots'>\n" + "\n".join(plots) + "\n</div>"


def _breakdown(title: str, content: Grid) -> str:
    state = "" if len(content.lines) > _FOLD else " open"
    return f"<details{state}><summary><h2>{escape(title)}</h2></summary>\n{_table(content)}{_flags(content)}</details>"


def provenance_list(provenance: dict[str, Any]) -> str:
    """Return what is known of the making of the numbers, as a section."""
    facts = flatten(provenance)
    if not facts:
        return ""
    lines = "\n".join(f"<dt>{escape(key)}</dt><dd>{escape(value)}</dd>" for key, value in facts)
    return f"<h2 id='provenance'>Provenance</h2>\n<dl>\n{lines}\n</dl>"

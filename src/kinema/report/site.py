"""Write a table as Markdown, CSV, LaTeX and a web page: ours beside the paper's, the same bytes for the same input."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kinema.atomic import write_text
from kinema.report import escape
from kinema.report.cells import FLAG, Cell, Column, Grid, Line
from kinema.report.content import content_of
from kinema.report.effects import HEADINGS, Effect
from kinema.report.effects import csv_text as effects_csv
from kinema.report.escape import spreadsheet
from kinema.report.packs import sweep, write_pack
from kinema.report.page import html_page
from kinema.report.text import (
    EFFECTS,
    effects_legend,
    flags_legend,
    flatten,
    legend,
    notes_by_text,
    notice,
    unfinished,
)

if TYPE_CHECKING:
    from kinema.types import Motion


def render(table: dict[str, Any], out_dir: str | Path, motions: dict[str, list[Motion]] | None = None) -> list[Path]:
    """Write table.md, table.csv, table.tex, table.json, index.html, motions/ and, of its effects, effects.csv.

    `table` has name, title, columns, rows and, if known, corpus, scale, panel (the corpus of the published numbers),
    comparable (whether corpus and scale are the same), intervals (student or published), provenance, footnotes,
    effects, breakdowns and runs (cards.py). `motions` are shown by row key. table.json holds all that pages are made
    of. Gives the paths of the files, those of motions aside.
    """
    content = content_of(table)
    known = [line.key for line in content.main.lines]
    stray = sorted(set(motions or {}) - set(known))
    if stray:
        raise ValueError(f"motions are given for {stray[0]!r}, which is no row of the table; rows: {', '.join(known)}")
    out = Path(out_dir)
    packs = {key: write_pack(found, out) for key, found in sorted((motions or {}).items()) if found}
    sweep(out, packs)
    content = replace(content, table={**table, "motions": packs})
    main, seen = content.main, content.seen
    return [
        write_text(out / "table.md", markdown(table, main, content.breakdowns, seen)),
        write_text(out / "table.csv", csv_text(main)),
        write_text(out / "table.tex", latex(table, main)),
        write_text(out / "table.json", json.dumps(content.table, sort_keys=True, ensure_ascii=False) + "\n"),
        *([write_text(out / "effects.csv", effects_csv(seen))] if seen else []),
        write_text(out / "index.html", html_page(content)),
    ]


def markdown(table: dict[str, Any], main: Grid, breakdowns: list[tuple[str, Grid]], seen: Sequence[Effect] = ()) -> str:
    """Write the whole report but the motions."""
    parts = [f"# {escape.markdown(table['title'])}", f"> {escape.markdown(notice(table))}"]
    parts += [_markdown_grid(main), legend(main)]
    parts += filter(None, [flags_legend(main)])
    notes = [
        f"- {escape.markdown(note)}" for note in (*notes_by_text(main), *table.get("footnotes", ()), *unfinished(main))
    ]
    if notes:
        parts += ["## Notes", "\n".join(notes)]
    if seen:
        rows = [HEADINGS, ("---", "---", "--:", "--:", "---"), *(effect.cells for effect in seen)]
        parts += [f"## {EFFECTS}", effects_legend(main), "\n".join(map(_markdown_row, rows))]
    for title, content in breakdowns:
        parts += [f"## {escape.markdown(title)}", _markdown_grid(content), *filter(None, [flags_legend(content)])]
    facts = flatten(table.get("provenance", {}))
    if facts:
        parts += [
            "## Provenance",
            "\n".join(f"- {escape.markdown(key)}: `{escape.code(value)}`" for key, value in facts),
        ]
    return "\n\n".join(parts) + "\n"


def csv_text(main: Grid) -> str:
    """Write one line per row; per metric the mean, half-interval and count of ours and the paper's two numbers."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    names = ("", "_half", "_n", "_paper", "_paper_half")
    writer.writerow(
        [
            "key",
            "label",
            "kind",
            "replications",
            "seeds",
            *(spreadsheet(c.key + n) for c in main.columns for n in names),
        ]
    )
    for line in main.lines:
        numbers = [text for cell in line.cells for text in _csv_cell(cell)]
        writer.writerow(
            [spreadsheet(line.key), spreadsheet(line.label), line.kind, line.replications, line.seeds or "", *numbers]
        )
    return file.getvalue()


def latex(table: dict[str, Any], main: Grid) -> str:
    """Write a booktabs table, the paper's numbers in a second line below ours."""
    arrows = {"↑": r"$\uparrow$", "↓": r"$\downarrow$", "→": r"$\rightarrow$"}
    headings = [escape.tex(c.label) + arrows.get(c.heading[-1], "") for c in main.columns]
    body = []
    for before, line in zip((None, *main.lines), main.lines, strict=False):
        if before is not None and before.kind != line.kind:
            body.append(r"\midrule")
        body.append(
            " & ".join([escape.tex(line.label), line.state, *(_tex_ours(c, line) for c in _ours(main, line))]) + r" \\"
        )
        if line.has_paper:
            paper = [_tex_value(text) if text else "" for text in _paper(main, line)]
            body.append(" & ".join([r"\quad published", "", *paper]) + r" \\")
    return "\n".join(
        [
            f"% {escape.one_line(notice(table))}",
            r"% needs \usepackage{booktabs}",
            r"\begin{tabular}{lr" + "c" * len(headings) + "}",
            r"\toprule",
            " & ".join(["", "$n$", *headings]) + r" \\",
            r"\midrule",
            *body,
            r"\bottomrule",
            r"\end{tabular}",
            "",
        ]
    )


def _markdown_grid(content: Grid) -> str:
    head = ["", "n", *(c.heading for c in content.columns)]
    rows = [head, [":--", "--:", *("--:" for _ in content.columns)]]
    for line in content.lines:
        ours = [f"**{text}**" if best else text or "–" for text, best in _ours(content, line)]
        ours = ours if line.replications else [""] * len(ours)
        rows.append([line.label, line.state, *ours])
        if line.has_paper:
            rows.append(
                [f"&nbsp;&nbsp;*{line.label}, paper*", "", *(f"*{t}*" if t else "" for t in _paper(content, line))]
            )
    return "\n".join(map(_markdown_row, rows))


def _markdown_row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(escape.markdown(text).replace("|", "\\|") for text in cells) + " |"


def _ours(content: Grid, line: Line) -> list[tuple[str, bool]]:
    return [(_our_text(column, cell), cell.best) for column, cell in zip(content.columns, line.cells, strict=True)]


def _our_text(column: Column, cell: Cell) -> str:
    text = cell.ours.text(column.digits) if cell.ours else ""
    return f"{text} {FLAG}" if cell.flagged else text


def _paper(content: Grid, line: Line) -> list[str]:
    return [
        cell.paper.text(column.digits) if cell.paper else ""
        for column, cell in zip(content.columns, line.cells, strict=True)
    ]


def _csv_cell(cell: Cell) -> list[str]:
    ours = (cell.ours.mean, cell.ours.half, cell.ours.count) if cell.ours else (None, None, None)
    paper = (cell.paper.mean, cell.paper.half) if cell.paper else (None, None)
    return ["" if number is None else f"{number:.8g}" for number in (*ours, *paper)]


def _tex_ours(cell: tuple[str, bool], line: Line) -> str:
    text, best = cell
    if not text:
        return "--" if line.replications else ""
    return rf"$\mathbf{{{_tex_value(text).strip('$')}}}$" if best else _tex_value(text)


def _tex_value(text: str) -> str:
    signs = text.replace("±", r"\pm").replace(f" {FLAG}", r"^{\dagger}")
    return text if text == "not finite" else f"${signs}$"

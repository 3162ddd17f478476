"""Write what a page measured: each part a CSV and a plot, all parts on one page."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kinema.atomic import replacing, write_json, write_text
from kinema.motion.view.draw import new_figure
from kinema.report.packs import sweep, write_pack
from kinema.report.sections import sections_page
from kinema.report.text import flatten
from kinema.runs.console import console

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from kinema.types import Motion

Rows = list[dict[str, Any]]


@dataclass(frozen=True)
class Section:
    """Hold one part: all rows (CSV), those on the page, and what draws it, in how many inches."""

    name: str
    rows: Rows
    shown: Rows
    draw: Callable[[Figure], None]
    inches: tuple[float, float] = field(default=(9.0, 4.0))


def write_page(
    page: dict[str, Any],
    sections: list[Section],
    provenance: dict[str, Any],
    out: Path,
    motions: Mapping[str, Sequence[Motion]] | None = None,
    where: str = "",
) -> list[Path]:
    """Write NAME.csv and, where matplotlib is installed, NAME.png of each section, README.md, page.json, index.html.

    `page` holds the page's `title` and `lead`, and title and text of every section by its name. `motions` are played on
    the web page, by the label of who made them; `where` says on which corpus and scale.
    """
    written, blocks, parts = [], [f"# {page['title']}", page["lead"].strip()], []
    for section in sections:
        about, image = page["sections"][section.name], f"{section.name}.png"
        written.append(write_text(out / f"{section.name}.csv", csv_text(section.rows)))
        blocks += [f"## {about['title']}", about["text"].strip()]
        try:
            written.append(_draw(section, out / image))
            blocks.append(f"![{about['title']}]({image})")
        except ImportError as error:
            image = ""
            console.print(f"[yellow]note[/]      no figure {section.name}: {error}")
        blocks += [markdown(section.shown), f"All numbers: [{section.name}.csv]({section.name}.csv)."]
        parts.append({"name": section.name, **about, "image": image, "rows": section.shown})
    facts = "\n".join(f"- {key}: `{value}`" for key, value in flatten(provenance))
    told = {"title": page["title"], "lead": page["lead"], "sections": parts, "provenance": provenance}
    if motions:
        packs = {label: write_pack(made, out) for label, made in motions.items()}
        sweep(out, packs)
        sources = [{"label": label, "kind": "method", **pack} for label, pack in packs.items()]
        told["motions"] = {"title": page["title"], "where": where, "sources": sources}
        blocks.append("The motions play in index.html.")
    return [
        *written,
        write_text(out / "README.md", "\n\n".join([*blocks, "## Provenance", facts]) + "\n"),
        write_json(out / "page.json", told),
        write_text(out / "index.html", sections_page(told)),
    ]


def csv_text(rows: Rows) -> str:
    """Write rows as CSV; a key that a row lacks is an empty cell."""
    file = io.StringIO()
    names = list(dict.fromkeys(key for row in rows for key in row))
    writer = csv.DictWriter(file, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows({key: _rounded(value) for key, value in row.items()} for row in rows)
    return file.getvalue()


def markdown(rows: Rows) -> str:
    """Write rows as a Markdown table, numbers to three digits."""
    names = list(dict.fromkeys(key for row in rows for key in row))
    lines = [names, ["---"] * len(names), *([_cell(row.get(name)) for name in names] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def pivot(rows: Rows, column: str, value: str, keys: Sequence[str]) -> Rows:
    """Return a row for each combination of `keys`, with what `column` names as columns that hold `value`."""
    found: dict[tuple[Any, ...], dict[str, Any]] = {}
    for row in rows:
        own = {key: row[key] for key in keys}
        found.setdefault(tuple(own.values()), own)[row[column]] = row[value]
    return list(found.values())


def _draw(section: Section, path: Path) -> Path:
    figure = new_figure(*section.inches, dpi=120)
    section.draw(figure)
    figure.tight_layout()
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png", metadata={"Software": None})
    return path


def _rounded(value: Any) -> Any:
    return float(f"{value:.6g}") if isinstance(value, float) else value


def _cell(value: Any) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    return f"{value:.3g}" if isinstance(value, float) else str(value)

"""Write the site: a first page over all tables and pages of a folder, and one gallery of all their motions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from kinema.atomic import write_text
from kinema.files.json import Kind, read_json
from kinema.files.kinds import refuse
from kinema.report.content import Content, content_of
from kinema.report.gallery import Group, gallery, group_of, moved
from kinema.report.page import document, html_page
from kinema.report.sections import sections_page
from kinema.report.text import PAPER_CORPORA

TITLE = "Kinema: results"
_HOME = "../index.html"


def write_site(reports: str | Path) -> list[Path]:
    """Write index.html and gallery.html of a folder, and anew what lies in its folders, with the way back.

    Tables are folders with a table.json, pages with a page.json; of other folders with a report in Markdown the
    files are listed. Nothing is computed but cells. Raises FileNotFoundError for a folder without any of these.
    """
    reports = Path(reports)
    folders = sorted(path for path in reports.iterdir() if path.is_dir()) if reports.is_dir() else []
    tables = [_table_of(f) for f in folders if (f / "table.json").exists()]
    pages = [_page_of(f) for f in folders if (f / "page.json").exists()]
    others = [f for f in folders if f.name not in {made.name for made in (*tables, *pages)} and any(f.glob("*.md"))]
    if not (tables or pages or others):
        raise FileNotFoundError(f"{reports} holds no report; make one: `kinema reproduce table5`")
    groups = [made.motions for made in (*tables, *pages) if made.motions]
    parts = [
        f"<header class='kinema-page-head'><h1>{TITLE}</h1></header>",
        _tables([table.line for table in tables]),
        "<p><a href='gallery.html'>All motions, prompt by prompt, methods beside or over each other</a></p>"
        if groups
        else "",
        _pages([page.line for page in pages]),
        _others(others),
    ]
    texts = {reports / "index.html": document(TITLE, parts)}
    if groups:
        heading = "<header class='kinema-page-head'><h1>Gallery</h1></header>"
        groups.sort(key=lambda group: -len(group["sources"]))
        texts[reports / "gallery.html"] = document("Gallery", [heading, gallery(groups)], "index.html")
    texts |= {reports / made.name / "index.html": made.page for made in (*tables, *pages)}
    return [write_text(path, text) for path, text in texts.items()]


@dataclass(frozen=True)
class _Made:
    """Hold what a folder gives to the site: its own page, its line on the first, and its motions."""

    name: str
    page: str
    line: str
    motions: Group | None


def _table_of(folder: Path) -> _Made:
    def make(told: dict[str, Any]) -> _Made:
        content = content_of(told)
        motions = group_of(content.table, f"{folder.name}/")
        return _Made(folder.name, html_page(content, _HOME), _table(folder.name, content), motions)

    return _made(folder / "table.json", {"title": str, "columns": list, "rows": list}, make)


def _page_of(folder: Path) -> _Made:
    def make(told: dict[str, Any]) -> _Made:
        motions = moved(told["motions"], f"{folder.name}/") if "motions" in told else None
        line = f"<li><a href='{escape(folder.name)}/index.html'>{escape(told['title'])}</a></li>"
        return _Made(folder.name, sections_page(told, _HOME), line, motions)

    return _made(folder / "page.json", {"title": str, "sections": list}, make)


def _made(path: Path, kind: Kind, make: Callable[[dict[str, Any]], _Made]) -> _Made:
    """Make what a report's file tells; raises ValueError naming it if it lacks something."""
    fix = "render its report again with `kinema reproduce`"
    told = read_json(path, kind, fix=fix)
    try:
        return make(told)
    except (ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
        raise refuse(path, f"is damaged ({type(error).__name__}: {error})", fix) from None


def _tables(lines: list[str]) -> str:
    if not lines:
        return ""
    heads = ("table", "corpus", "scale", "rows", "without results", "as in the paper", "opposite", "files")
    head = "".join(f"<th scope='col'>{text}</th>" for text in heads)
    rows = "\n".join(lines)
    return (
        "<h2>Tables</h2>\n<div class='scroll' tabindex='0'><table class='sortable'>\n"
        f"<thead><tr>{head}</tr></thead>\n<tbody>\n{rows}\n</tbody></table></div>\n"
        "<p class='small'>As in the paper, opposite: effects of a table (differences between two of its rows) by their "
        "sign. Levels are compared on each table's page.</p>"
    )


def _table(name: str, content: Content) -> str:
    table, lines = content.table, content.main.lines
    verdicts = [effect.verdict for effect in content.seen]
    idle = sum(not line.replications for line in lines)
    corpus = str(table.get("corpus") or "")
    cells = [PAPER_CORPORA.get(corpus, corpus), str(table.get("scale") or "")]
    counts = [len(lines), idle, verdicts.count("as in the paper"), verdicts.count("opposite to the paper")]
    files = ["table.md", "table.csv", "table.tex", "table.json"]
    link = f"<a href='{escape(name)}/index.html'>{escape(table['title'])}</a>"
    return (
        f"<tr><th scope='row'>{link}</th>"
        + "".join(f"<td>{escape(cell)}</td>" for cell in cells)
        + "".join(f"<td data-ours='{n}'>{n}</td>" for n in counts)
        + f"<td>{' '.join(_file(name, file) for file in files)}</td></tr>"
    )


def _pages(lines: list[str]) -> str:
    return f"<h2>Measurements</h2>\n<ul>{''.join(lines)}</ul>" if lines else ""


def _others(folders: list[Path]) -> str:
    """List the files of folders that leave no data for pages (figures), their images shown."""
    items = []
    for folder in folders:
        names = [path.name for path in sorted(folder.iterdir()) if path.is_file()]
        files = " ".join(_file(folder.name, name) for name in names)
        images = "".join(
            f"<img src='{escape(folder.name)}/{escape(name)}' alt='{escape(name)}'>"
            for name in names
            if name.endswith((".png", ".svg"))
        )
        items.append(f"<section class='measured'><h3>{escape(folder.name)}</h3>\n{images}\n<p>{files}</p></section>")
    return "<h2>Figures and other reports</h2>\n" + "\n".join(items) if items else ""


def _file(folder: str, name: str) -> str:
    return f"<a href='{escape(folder)}/{escape(name)}'>{escape(name.removeprefix('table.'))}</a>"

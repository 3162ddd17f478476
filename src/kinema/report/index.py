"""Write the site: a first page over all tables and pages of a folder, and one gallery of all their motions."""

from __future__ import annotations

import json
from html import escape
from pathlib import Path
from typing import Any

from kinema.atomic import write_text
from kinema.report.content import Content, content_of
from kinema.report.gallery import gallery, group_of, moved
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
    tables = {f.name: content_of(_read(f / "table.json")) for f in folders if (f / "table.json").exists()}
    pages = {f.name: _read(f / "page.json") for f in folders if (f / "page.json").exists()}
    others = [f for f in folders if f.name not in {*tables, *pages} and any(f.glob("*.md"))]
    if not (tables or pages or others):
        raise FileNotFoundError(f"{reports.absolute()} holds no report; make one: `kinema reproduce table5`")
    groups = [g for name, content in tables.items() if (g := group_of(content.table, f"{name}/"))]
    groups += [moved(told["motions"], f"{name}/") for name, told in pages.items() if "motions" in told]
    parts = [
        f"<header class='kinema-page-head'><h1>{TITLE}</h1></header>",
        _tables(tables),
        "<p><a href='gallery.html'>All motions, prompt by prompt, methods beside or over each other</a></p>"
        if groups
        else "",
        _pages({name: told["title"] for name, told in pages.items()}),
        _others(others),
    ]
    written = [write_text(reports / "index.html", document(TITLE, parts))]
    if groups:
        heading = "<header class='kinema-page-head'><h1>Gallery</h1></header>"
        groups.sort(key=lambda group: -len(group["sources"]))
        text = document("Gallery", [heading, gallery(groups)], "index.html")
        written.append(write_text(reports / "gallery.html", text))
    texts = {name: html_page(content, _HOME) for name, content in tables.items()}
    texts |= {name: sections_page(told, _HOME) for name, told in pages.items()}
    return [*written, *(write_text(reports / name / "index.html", text) for name, text in texts.items())]


def _read(path: Path) -> dict[str, Any]:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{path} is damaged ({error}); render its report again with `kinema reproduce`") from None


def _tables(tables: dict[str, Content]) -> str:
    if not tables:
        return ""
    heads = ("table", "corpus", "scale", "rows", "without results", "as in the paper", "opposite", "files")
    head = "".join(f"<th scope='col'>{text}</th>" for text in heads)
    rows = "\n".join(_table(name, content) for name, content in tables.items())
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


def _pages(titles: dict[str, str]) -> str:
    items = "".join(f"<li><a href='{escape(n)}/index.html'>{escape(t)}</a></li>" for n, t in titles.items())
    return f"<h2>Measurements</h2>\n<ul>{items}</ul>" if items else ""


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

"""Write a page of sections (figures, studies) as a web page, from what its page.json holds."""

from __future__ import annotations

import math
from html import escape
from typing import Any

from kinema.report.gallery import gallery
from kinema.report.page import document, provenance_list


def sections_page(told: dict[str, Any], home: str | None = None) -> str:
    """Return the document: title, lead, sections (name, title, text, image, rows), motions and provenance."""
    parts = [
        f"<header class='kinema-page-head'><h1>{escape(told['title'])}</h1></header>",
        _text(told["lead"]),
        *(_section(section) for section in told["sections"]),
        gallery([told["motions"]] if "motions" in told else []),
        provenance_list(told["provenance"]),
    ]
    return document(told["title"], parts, home)


def _section(section: dict[str, Any]) -> str:
    name, title = escape(section["name"]), escape(section["title"])
    image = section.get("image")
    shown = f"<p><img src='{escape(image)}' alt='{title}'></p>\n" if image else ""
    table = _table(section["rows"])
    return (
        f"<section class='measured'><h2>{title}</h2>\n{_text(section['text'])}\n{shown}{table}\n"
        f"<p class='small'>All numbers: <a href='{name}.csv'>{name}.csv</a></p></section>"
    )


def _table(rows: list[dict[str, Any]]) -> str:
    names = list(dict.fromkeys(key for row in rows for key in row))
    head = "".join(f"<th scope='col'>{escape(name)}</th>" for name in names)
    body = "\n".join(f"<tr>{''.join(_cell(row.get(name)) for name in names)}</tr>" for row in rows)
    return (
        f"<div class='scroll' tabindex='0'><table class='sortable'>\n<thead><tr>{head}</tr></thead>\n"
        f"<tbody>\n{body}\n</tbody></table></div>"
    )


def _cell(value: Any) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "<td data-ours=''></td>"
    if isinstance(value, int | float) and not isinstance(value, bool):
        return f"<td data-ours='{value:.8g}'>{value:.3g}</td>" if isinstance(value, float) else _whole(value)
    return f"<td>{escape(str(value))}</td>"


def _whole(value: int) -> str:
    return f"<td data-ours='{value}'>{value}</td>"


def _text(text: str) -> str:
    return "\n".join(f"<p>{escape(part.strip())}</p>" for part in text.split("\n\n") if part.strip())

"""Show the motions of many rows together: prompt by prompt, chosen by method, side by side or one over the other."""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from typing import Any

from kinema.motion.view.html import TOOLBAR
from kinema.report.assets import asset

Group = dict[str, Any]
"""A table of the gallery: its title and its sources (label, kind, pack, motions)."""


def group_of(table: dict[str, Any], place: str = "") -> Group | None:
    """Return the rows of a table that have motions, in its order; `place` is its folder, seen from the page."""
    packs = table.get("motions", {})
    sources = [
        {"label": row["label"], "kind": row["kind"], **packs[row["key"]], "pack": place + packs[row["key"]]["pack"]}
        for row in table["rows"]
        if row["key"] in packs
    ]
    where = ", ".join(str(table[key]) for key in ("corpus", "scale") if table.get(key))
    return {"title": table["title"], "where": where, "sources": sources} if sources else None


def moved(group: Group, place: str) -> Group:
    """Return a group as it is seen from a page of which its own is in the folder `place`."""
    return {**group, "sources": [{**source, "pack": place + source["pack"]} for source in group["sources"]]}


def gallery(groups: Sequence[Group]) -> str:
    """Return the section; its players are made by gallery.js and read their motions when they come into view."""
    if not groups:
        return ""
    edits = any(motion["edit"] for group in groups for source in group["sources"] for motion in source["motions"])
    legend = (
        "<p class='small kinema-legend'>Edits:<i class='kinema-kept'></i>kept frames"
        "<i class='kinema-made'></i>generated frames</p>"
    )
    return (
        "<section class='kinema-viewer kinema-gallery' id='motions' data-sync>\n<h2>Motions</h2>\n"
        f"{TOOLBAR}\n{legend if edits else ''}<div class='kinema-choice'></div>\n<div class='kinema-prompts'></div>\n"
        f"<script type='application/json'>{inert(list(groups))}</script>\n"
        f"<noscript>{escape('The players need JavaScript.')}</noscript>\n</section>"
    )


def inert(value: Any) -> str:
    """Write JSON that no HTML parser takes for anything else."""
    text = json.dumps(value, separators=(",", ":"), ensure_ascii=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def gallery_script() -> str:
    """Return the script that makes the players of a page's galleries."""
    return asset("gallery.js")

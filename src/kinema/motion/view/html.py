"""Show motions in the browser: one self-contained page of players, no network, no libraries."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Sequence
from html import escape
from importlib import resources
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

from kinema.atomic import write_text
from kinema.motion.view.packed import broken_from, playable

if TYPE_CHECKING:
    from kinema.types import Motion

SCRIPTS = ("track.js", "figure.js", "scene.js", "viewer.js")


def save_html(
    motions: Sequence[Motion],
    path: str | Path,
    title: str = "Kinema motions",
    *,
    labels: Sequence[str] | None = None,
    groups: Sequence[str] | None = None,
    sync: bool = False,
) -> Path:
    """Write one self-contained page that plays the motions in a grid, each with its caption (see `viewer_fragment`)."""
    if not motions:
        raise ValueError("save_html got no motions: pass at least one")
    heading = f"<header class='kinema-page-head'><h1>{escape(title)}</h1><p>{_count(motions)}</p></header>"
    players = viewer_fragment(motions, labels=labels, groups=groups, sync=sync)
    return write_text(path, page(title, f"<main class='kinema-page'>{heading}{players}</main>"))


def page(title: str, body: str, style: str = "", script: str = "") -> str:
    """Wrap a body into a complete HTML document that follows the reader's dark or light preference.

    With a `script` the document runs this one, and scripts of files beside it, and nothing else.
    """
    document = (
        "<!doctype html>\n<html lang='en'>\n<head>\n<meta charset='utf-8'>\n"
        "<meta name='viewport' content='width=device-width, initial-scale=1'>\n"
        f"<meta name='color-scheme' content='light dark'>\n{_policy(script)}"
        f"<title>{escape(title)}</title>\n<style>\n{_asset('theme.css')}{_asset('page.css')}{style}</style>\n</head>\n"
        f"<body>\n{body}\n{f'<script>{script}</script>' if script else ''}\n</body>\n</html>\n"
    )
    return document.encode("utf-8", errors="replace").decode()  # half a surrogate pair becomes `?`


def _policy(script: str) -> str:
    if not script:
        return ""
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    scripts = f"'sha256-{digest}' 'self' file:"
    rules = f"default-src 'none'; img-src 'self' file:; style-src 'unsafe-inline'; script-src {scripts}"
    return f'<meta http-equiv="Content-Security-Policy" content="{rules}">\n'


def viewer_fragment(
    motions: Sequence[Motion],
    *,
    labels: Sequence[str] | None = None,
    groups: Sequence[str] | None = None,
    sync: bool = False,
) -> str:
    """Return the players, their toolbar, style and script for embedding into any page (several times if need be).

    `labels` names each motion (a method, say); neighbouring motions of equal `groups` stand below one heading. `sync`
    starts them on one clock. A motion with coordinates that are not finite gets a panel that says so, and no player.
    """
    labels, groups = _parallel(labels, motions, "labels"), _parallel(groups, motions, "groups")
    items = list(zip(motions, labels, groups, strict=True))
    sections = []
    for group, members in groupby(items, key=lambda item: item[2]):
        figures = "\n".join(_figure(motion, label, group) for motion, label, _ in members)
        heading = f"<h3 class='kinema-group'>{escape(group)}</h3>\n" if group else ""
        sections.append(f"{heading}<div class='kinema-grid'>\n{figures}\n</div>")
    kind = f"class='kinema-viewer{' kinema-many' * (len(motions) > 1)}'{' data-sync' * sync}"
    return (
        f"<style>\n{viewer_style()}</style>\n<section {kind}>\n{TOOLBAR}\n"
        + "\n".join(sections)
        + f"\n<noscript>The players need JavaScript.</noscript>\n</section>\n<script>\n{viewer_script()}</script>"
    )


def viewer_style() -> str:
    """Return what players look like."""
    return _asset("theme.css") + _asset("viewer.css")


def viewer_script() -> str:
    """Return the script that plays the players that stand before it; a page may hold it several times."""
    return f"if (!window.kinema) {{\nwindow.kinema = {{}};\n{''.join(map(_asset, SCRIPTS))}}}\nwindow.kinema.scan();\n"


def _figure(motion: Motion, label: str, group: str) -> str:
    """Make one player; what it needs to draw stands in a data attribute, which is read when it comes into view."""
    frames = len(motion.joints)
    facts = [f"{frames} frames", f"{frames / motion.fps:.1f} s"]
    if motion.seed is not None:
        facts.append(f"seed {motion.seed}")
    caption = "" if motion.text == group else escape(motion.text)
    text = (
        "<figcaption>"
        + (f"<span class='kinema-label'>{escape(label)}</span>" if label else "")
        + (f"<span class='kinema-caption'>{caption}</span>" if caption else "")
        + f"<span class='kinema-facts'>{' · '.join(facts)}</span></figcaption>"
    )
    broken = broken_from(motion)
    if broken is not None:
        panel = f"<p>Not finite from frame {broken} on:<br>this motion cannot be shown.</p>"
        return f"<figure class='kinema-player kinema-broken'><div class='kinema-stage'>{panel}</div>{text}</figure>"
    data = escape(json.dumps(playable(motion), separators=(",", ":")))
    return (
        f'<figure class="kinema-player" data-fps="{motion.fps:g}" data-frames="{frames}" data-motion="{data}">'
        "<div class='kinema-stage'><canvas tabindex='0' role='img' "
        f"aria-label='{escape(motion.text or label or 'motion')}'></canvas></div>{text}</figure>"
    )


def _parallel(names: Sequence[str] | None, motions: Sequence[Motion], what: str) -> Sequence[str]:
    if names is None:
        return [""] * len(motions)
    if len(names) != len(motions):
        raise ValueError(f"viewer_fragment got {len(names)} {what} for {len(motions)} motions: pass one for each")
    return names


def _count(motions: Sequence[Motion]) -> str:
    seconds = sum(len(m.joints) / m.fps for m in motions)
    return f"{len(motions)} motion{'s' if len(motions) != 1 else ''} · {seconds:.1f} s"


def _asset(name: str) -> str:
    return resources.files("kinema.motion.view").joinpath(name).read_text(encoding="utf-8")


TOOLBAR = """<div class='kinema-toolbar' role='toolbar' aria-label='All motions'>
<button type='button' data-action='play'>Pause all</button>
<button type='button' data-action='sync' aria-pressed='false' title='One clock and one camera for all'>In sync</button>
<label hidden>Time <input type='range' min='0' max='1' step='0.001' value='0' data-action='seek'
aria-label='Time of all motions'></label>
<button type='button' data-action='follow' aria-pressed='true' title='The camera follows the root'>Follow</button>
<button type='button' data-action='trail' aria-pressed='true' title='Path of the root on the ground'>Trail</button>
<button type='button' data-action='reset' title='Reset the cameras'>Reset view</button>
<label>Speed <select data-action='speed' aria-label='Speed'><option>0.25</option><option>0.5</option>
<option selected>1</option><option>2</option></select></label>
<span class='kinema-legend'><i class='kinema-left'></i>left <i class='kinema-right'></i>right
<i class='kinema-stands'></i>foot stands</span>
<span class='kinema-hint'>drag to orbit · click, then wheel to zoom · double-click resets ·
space plays · ← → step</span>
</div>"""
"""The controls of all players of a page."""

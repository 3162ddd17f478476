"""Show motions in the browser: one self-contained page of stick-figure players, no network, no libraries."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from importlib import resources
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kinema.atomic import write_text
from kinema.motion.view.body import Body, body_of, metres

if TYPE_CHECKING:
    from kinema.types import Motion

_INT16 = 32767


def save_html(motions: Sequence[Motion], path: str | Path, title: str = "Kinema motions") -> Path:
    """Write one self-contained page that plays the motions in a grid, each with its caption."""
    if not motions:
        raise ValueError("save_html got no motions: pass at least one")
    heading = f"<header class='kinema-page-head'><h1>{escape(title)}</h1><p>{_count(motions)}</p></header>"
    return write_text(path, page(title, f"<main class='kinema-page'>{heading}{viewer_fragment(motions)}</main>"))


def page(title: str, body: str, style: str = "") -> str:
    """Wrap a body into a complete HTML document that follows the reader's dark or light preference."""
    return (
        "<!doctype html>\n<html lang='en'>\n<head>\n<meta charset='utf-8'>\n"
        "<meta name='viewport' content='width=device-width, initial-scale=1'>\n"
        "<meta name='color-scheme' content='light dark'>\n"
        f"<title>{escape(title)}</title>\n<style>\n{_asset('theme.css')}{_asset('page.css')}{style}</style>\n</head>\n"
        f"<body>\n{body}\n</body>\n</html>\n"
    )


def viewer_fragment(
    motions: Sequence[Motion],
    *,
    labels: Sequence[str] | None = None,
    groups: Sequence[str] | None = None,
) -> str:
    """Return the players, their toolbar, style and script for embedding into any page (several times if need be).

    `labels` names each motion (a method, say); neighbouring motions of equal `groups` stand below one heading. A motion
    with coordinates that are not finite gets a panel that says so instead of a player.
    """
    labels, groups = _parallel(labels, motions, "labels"), _parallel(groups, motions, "groups")
    items = list(zip(motions, labels, groups, strict=True))
    sections = []
    for group, members in groupby(items, key=lambda item: item[2]):
        figures = "\n".join(_figure(motion, label, group) for motion, label, _ in members)
        heading = f"<h3 class='kinema-group'>{escape(group)}</h3>\n" if group else ""
        sections.append(f"{heading}<div class='kinema-grid'>\n{figures}\n</div>")
    return (
        f"<style>\n{_asset('theme.css')}{_asset('viewer.css')}</style>\n<section class='kinema-viewer'>\n{_TOOLBAR}\n"
        + "\n".join(sections)
        + f"\n<noscript>The players need JavaScript.</noscript>\n</section>\n<script>\n{_asset('viewer.js')}</script>"
    )


@dataclass(frozen=True)
class Packed:
    """Hold joints in metres as 16-bit integers: `value = integer * scale + centre`, per axis centre, one scale."""

    data: str
    scale: float
    centre: tuple[float, float, float]


def pack(joints: np.ndarray) -> Packed:
    """Quantise joint positions (frames, joints, 3) to int16 in base64; the error is at most half of `scale`."""
    flat = joints.reshape(-1, 3).astype(np.float64)
    low, high = flat.min(axis=0), flat.max(axis=0)
    centre = (low + high) / 2
    scale = max(float((high - low).max()) / 2 / _INT16, 1e-9)
    integers = np.rint((flat - centre) / scale).clip(-_INT16, _INT16).astype("<i2")
    x, y, z = (float(c) for c in centre)
    return Packed(base64.b64encode(integers.tobytes()).decode(), scale, (x, y, z))


def _figure(motion: Motion, label: str, group: str) -> str:
    """Make one player; what it needs to draw stands in data attributes."""
    body = body_of(motion)
    joints = metres(motion)
    caption = "" if motion.text == group else escape(motion.text)
    facts = [f"{len(joints)} frames", f"{len(joints) / motion.fps:.1f} s"]
    if motion.seed is not None:
        facts.append(f"seed {motion.seed}")
    text = (
        "<figcaption>"
        + (f"<span class='kinema-label'>{escape(label)}</span>" if label else "")
        + (f"<span class='kinema-caption'>{caption}</span>" if caption else "")
        + f"<span class='kinema-facts'>{' · '.join(facts)}</span></figcaption>"
    )
    broken = np.flatnonzero(~np.isfinite(joints).all(axis=(1, 2)))
    if len(broken):
        panel = f"<p>Not finite from frame {broken[0]} on:<br>this motion cannot be shown.</p>"
        return f"<figure class='kinema-player kinema-broken'><div class='kinema-stage'>{panel}</div>{text}</figure>"
    name = escape(motion.text or label or "motion")
    return (
        f"<figure class='kinema-player' {_attributes(body, pack(joints), motion.fps)}>"
        f"<div class='kinema-stage'><canvas tabindex='0' role='img' aria-label='{name}'></canvas></div>"
        f"{_CONTROLS}{text}</figure>"
    )


def _attributes(body: Body, packed: Packed, fps: float) -> str:
    values = {
        "fps": f"{fps:g}",
        "parents": ",".join(map(str, body.parents)),
        "sides": ",".join(map(str, body.sides)),
        "face": ",".join(map(str, body.face_joints)),
        "head": str(body.head),
        "stature": f"{body.stature:.4f}",
        "scale": f"{packed.scale:.9g}",
        "centre": ",".join(f"{c:.6g}" for c in packed.centre),
        "joints": packed.data,
    }
    return " ".join(f"data-{key}='{value}'" for key, value in values.items())


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


_CONTROLS = (
    "<div class='kinema-controls'><button type='button' class='kinema-play' aria-label='Play or pause'></button>"
    "<input type='range' min='0' value='0' step='1' aria-label='Frame'>"
    "<output class='kinema-clock'></output></div>"
)

_TOOLBAR = """<div class='kinema-toolbar' role='toolbar' aria-label='All motions'>
<button type='button' data-action='play'>Pause all</button>
<button type='button' data-action='sync' aria-pressed='false' title='One clock and one camera for all'>In sync</button>
<button type='button' data-action='follow' aria-pressed='true' title='The camera follows the root'>Follow</button>
<button type='button' data-action='trail' aria-pressed='true' title='Path of the root on the ground'>Trail</button>
<button type='button' data-action='reset' title='Reset the cameras'>Reset view</button>
<label>Speed <select data-action='speed' aria-label='Speed'><option>0.25</option><option>0.5</option>
<option selected>1</option><option>2</option></select></label>
<span class='kinema-legend'><i class='kinema-left'></i>left <i class='kinema-right'></i>right</span>
<span class='kinema-hint'>drag to orbit · click, then wheel to zoom · double-click resets ·
space plays · ← → step</span>
</div>"""

"""Make what gradio has no component for: the players in a frame of their own, the timeline, one line of an error."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from importlib import resources

import gradio as gr

from kinema.demo.studio import Take
from kinema.motion.view.html import page, viewer_fragment

EMPTY = "<p class='demo-empty'>Motions appear here.</p>"
FRAME_STYLE = "html { overflow: hidden; } body { padding: 2px; } .kinema-hint { display: none; }"


def players(takes: Sequence[Take]) -> str:
    """Return the players of all motions on one clock, in a frame without rights over the page."""
    if not takes:
        return EMPTY
    body = viewer_fragment([take.motion for take in takes], labels=[take.label for take in takes])
    document = page("Motions", f"{body}<script>{asset('inside.js')}</script>", FRAME_STYLE)
    return f'<iframe title="Motions" sandbox="allow-scripts" srcdoc="{escape(document)}"></iframe>'


def timeline() -> gr.HTML:
    """Return a line of time with two thumbs; its value is what `span` gives."""
    return gr.HTML(
        {"start": 0, "end": 1, "frames": 1, "fps": 1},
        html_template=asset("timeline.html"),
        js_on_load=asset("timeline.js"),
        elem_id="demo-timeline",
    )


def span(take: Take) -> dict[str, float]:
    """Return what the timeline shows of a motion: its second half is chosen."""
    frames = len(take.motion.joints)
    return {"start": frames // 2, "end": frames, "frames": frames, "fps": take.motion.fps}


def theme() -> gr.themes.Base:
    """Return colours as the players have them, in letters that are on every machine."""
    looks = gr.themes.Base(
        primary_hue="blue",
        neutral_hue="slate",
        radius_size="lg",
        font=["system-ui", "sans-serif"],
        font_mono=["ui-monospace", "monospace"],
    )
    return looks.set(
        body_background_fill="#ffffff",
        body_background_fill_dark="#10141b",
        block_background_fill="#f7f8fa",
        block_background_fill_dark="#181e28",
        button_primary_background_fill="#2767d8",
        button_primary_background_fill_hover="#1f55b5",
        button_primary_background_fill_dark="#2767d8",
        button_primary_background_fill_hover_dark="#3b7bea",
        button_primary_text_color="#ffffff",
        button_primary_text_color_dark="#ffffff",
    )


def error_line(message: object) -> str:
    """Return one line that says what is wrong."""
    return f"<p role='alert' class='demo-said demo-error'>{escape(' '.join(str(message).split()))}</p>"


def notes(messages: Sequence[object]) -> str:
    """Return a line for each thing that a visitor should know."""
    lines = dict.fromkeys(" ".join(str(message).split()) for message in messages)
    return "".join(f"<p role='status' class='demo-said'>{escape(line)}</p>" for line in lines)


def asset(name: str) -> str:
    """Return the text of a file of this folder."""
    return resources.files("kinema.demo").joinpath(name).read_text(encoding="utf-8")

"""Lay out the page: what is asked, the players, and what can be done with one motion (gradio Blocks)."""

from __future__ import annotations

import base64
import warnings
from collections.abc import Callable
from functools import wraps
from html import escape
from typing import Any, NamedTuple

import gradio as gr

from kinema.demo.studio import COUNT, LETTERS, Studio, Take, read_seed
from kinema.demo.views import EMPTY, asset, error_line, notes, players, span, timeline
from kinema.motion.body_parts import PARTS
from kinema.motion.export import FORMATS

WHOLE = "whole"
WAITING = 8
"""Requests that wait in line; further ones are told to come back."""
HOUR = 3600
ONE_BY_ONE: dict[str, Any] = {"concurrency_id": "model", "api_visibility": "private"}
"""How requests are answered: by one model, one at a time, and to this page alone."""

QUIET: dict[str, Any] = {**ONE_BY_ONE, "show_progress": "minimal"}


class Stage(NamedTuple):
    """Hold what shows a visitor's motions: `one` is what can be done with that which `which` chooses."""

    takes: gr.State
    players: gr.HTML
    one: gr.Column
    which: gr.Radio
    line: gr.HTML


def build(studio: Studio, title: str) -> gr.Blocks:
    """Build the page of a studio."""
    with gr.Blocks(title=f"Kinema · {title}", analytics_enabled=False) as blocks:
        gr.HTML(f"<h1 class='demo-title'>Kinema <small>{escape(title)}</small></h1>")
        with gr.Row():
            with gr.Column(scale=1, min_width=290, elem_classes="demo-request"):
                asked = _request(studio)
                go = gr.Button("Generate", variant="primary", elem_id="demo-generate")
            with gr.Column(scale=3, min_width=290):
                said = gr.HTML(visible=False, elem_id="demo-said")
                shown = gr.HTML(EMPTY, elem_id="demo-players", js_on_load=None)
                with gr.Column(visible=False, elem_classes="demo-card") as one:
                    which = gr.Radio([], label="Motion to change or save", elem_id="demo-which")
                    line, change, again = _change(studio)
                    stage = Stage(gr.State([], time_to_live=HOUR), shown, one, which, line)
                    file = gr.HTML(None, visible="hidden", html_template=" ", js_on_load=None, render=False)
                    _exports(studio, stage, file, said)
        file.render()
        how = {**ONE_BY_ONE, "show_progress_on": shown}
        makes = _answer(lambda *given: _show(_generate(studio, *given)), len(stage))
        edits = _answer(lambda *given: _show(_regenerate(studio, *given)), len(stage))
        gr.on([go.click, asked[0].submit], makes, [stage.takes, *asked], [*stage, said], **how)
        gr.on([again.click, change[0].submit], edits, [stage.takes, which, line, *change], [*stage, said], **how)
        which.input(lambda takes, number: span(studio.find(takes, number)), [stage.takes, which], line, **QUIET)
    return blocks.queue(max_size=WAITING, default_concurrency_limit=1, api_open=False)


def _request(studio: Studio) -> list[Any]:
    """Return the components that say what is to be generated, in the order of `_generate`."""
    text = gr.Textbox(
        "a person waves with the left hand", label="What the person does", max_length=LETTERS, elem_id="demo-text"
    )
    most = studio.longest
    seconds = gr.Slider(0.5, most, min(4.0, most), step=0.1, label="Length in seconds")
    own = gr.Checkbox(False, label="The model chooses the length", visible=studio.model.knows_lengths)
    count = gr.Slider(1, COUNT, 2, step=1, precision=0, label="How many")
    return [text, seconds, own, count, _seed()]


def _change(studio: Studio) -> tuple[gr.HTML, list[Any], gr.Button]:
    """Return the timeline, the components that say what a stretch becomes (see `_regenerate`), and their button."""
    with gr.Column(visible=studio.edits):
        line = timeline()
        with gr.Row(equal_height=True):
            what = "What the person does there"
            text = gr.Textbox("a person jumps", label=what, max_length=LETTERS, scale=3, elem_id="demo-change")
            part = gr.Radio([WHOLE, *PARTS], value=WHOLE, label="Body", visible=studio.edits_parts, scale=2)
            seed = _seed()
            again = gr.Button("Regenerate", scale=1, min_width=120, elem_id="demo-regenerate")
    return line, [text, part, seed], again


def _seed() -> gr.Textbox:
    return gr.Textbox(label="Seed", placeholder="drawn", max_length=20, scale=1, min_width=110)


def _exports(studio: Studio, stage: Stage, file: gr.HTML, said: gr.HTML) -> None:
    """Add a button per format; the file goes to the browser within the answer, and stays nowhere."""
    with gr.Row(elem_classes="demo-formats"):
        for suffix in FORMATS:
            name = f"demo-save{suffix.replace('.', '-')}"
            button = gr.Button(f"Save {suffix}", size="sm", min_width=90, elem_id=name)
            writes = _answer(lambda takes, number, s=suffix: (_encoded(*studio.write(takes, number, s)),), 1)
            how = {**QUIET, "show_progress_on": stage.which}
            written = button.click(writes, [stage.takes, stage.which], [file, said], **how)
            written.then(None, file, None, js=asset("download.js"))


def _generate(
    studio: Studio, takes: list[Take], text: str, seconds: float, own: bool, count: int, seed: str
) -> list[Take]:
    return studio.generate(takes, text, None if own else seconds, count, read_seed(seed))


def _regenerate(
    studio: Studio, takes: list[Take], number: int, chosen: dict[str, int], text: str, part: str, seed: str
) -> list[Take]:
    frames = (chosen["start"], chosen["end"])
    return studio.regenerate(takes, number, text, frames, None if part == WHOLE else part, read_seed(seed))


def _show(takes: list[Take]) -> tuple[Any, ...]:
    """Return what the components of a `Stage` become: the newest motion is the chosen one."""
    last = takes[-1]
    choices = [(take.label, take.number) for take in takes]
    return takes, players(takes), gr.update(visible=True), gr.update(choices=choices, value=last.number), span(last)


def _encoded(name: str, content: bytes) -> list[str]:
    return [name, base64.b64encode(content).decode()]


def _answer(action: Callable[..., tuple[Any, ...]], outputs: int) -> Callable[..., tuple[Any, ...]]:
    """Give what an action returns, and what it warns of; or nothing new, and one line that says why."""

    @wraps(action)
    def answer(*given: Any) -> tuple[Any, ...]:
        try:
            with warnings.catch_warnings(record=True) as told:
                warnings.simplefilter("always", UserWarning)
                made = action(*given)
        except (ValueError, OSError, ImportError) as error:
            return (*[gr.skip()] * outputs, gr.update(value=error_line(error), visible=True))
        said = notes([one.message for one in told if issubclass(one.category, UserWarning)])
        return (*made, gr.update(value=said, visible=bool(said)))

    return answer

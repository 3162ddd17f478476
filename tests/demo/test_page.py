"""What the page is made of, without a browser: a button per format, escaped texts, errors as one line, bounds."""

from __future__ import annotations

import asyncio
import re
import warnings
from html import unescape

import pytest

pytest.importorskip("gradio", reason="the demo needs gradio: make test-demo")

from kinema.demo.page import _answer, build
from kinema.demo.server import MOST_BYTES, Bounded
from kinema.demo.studio import Studio, Take
from kinema.demo.views import error_line, players
from kinema.motion.export import FORMATS


@pytest.fixture
def page(model):
    return build(Studio(model), "a <model>")


def test_there_is_a_button_for_every_format_that_is_known(page):
    buttons = [block.value for block in page.blocks.values() if (block.elem_id or "").startswith("demo-save")]
    assert buttons == [f"Save {suffix}" for suffix in FORMATS]


def test_nothing_of_it_is_told_to_others_and_one_request_runs_at_a_time(page):
    assert not page.analytics_enabled
    asked = [fn for fn in page.fns.values() if fn.fn is not None and fn.js is None]
    assert {fn.concurrency_id for fn in asked} == {"model"}
    assert {fn.api_visibility for fn in page.fns.values()} == {"private"}


def test_texts_are_text(model):
    (motion,) = model.generate("</script><img src=x onerror=alert(1)>", 20, seed=0)
    html = players([Take(1, motion, "<b>")])
    assert re.fullmatch(r'<iframe title="Motions" sandbox="allow-scripts" srcdoc="[^"<>]*"></iframe>', html)
    inside = unescape(html)
    assert "<img" not in inside
    assert "&lt;img src=x" in inside
    assert error_line("<b>\n no") == "<p role='alert' class='demo-said demo-error'>&lt;b&gt; no</p>"


def test_an_error_is_one_line_and_leaves_the_rest():
    def refuse():
        raise ValueError("count=9")

    *rest, said = _answer(refuse, 2)()
    assert rest == [{"__type__": "update"}] * 2
    assert said["visible"]
    assert "count=9" in said["value"]
    *given, silent = _answer(lambda: (1, 2), 2)()
    assert given == [1, 2]
    assert not silent["visible"]


def test_what_the_library_warns_of_is_told():
    def warn():
        for message in ("far <from> all", "far <from> all", "cut"):
            warnings.warn(message, stacklevel=1)
        warnings.warn("old", DeprecationWarning, stacklevel=1)
        return (1,)

    _, said = _answer(warn, 1)()
    lines = ("far &lt;from&gt; all", "cut")
    assert said["value"] == "".join(f"<p role='status' class='demo-said'>{line}</p>" for line in lines)
    assert said["visible"]


@pytest.mark.parametrize(
    ("method", "size", "answered"),
    [("GET", None, 200), ("POST", b"2000", 200), ("POST", b"%d" % (MOST_BYTES + 1), 413), ("POST", None, 413)],
)
def test_requests_are_bounded(method, size, answered):
    said = []

    async def app(scope, receive, send):
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def send(message):
        said.append(message)

    headers = [] if size is None else [(b"content-length", size)]
    asyncio.run(Bounded(app)({"type": "http", "method": method, "headers": headers}, None, send))
    assert said[0]["status"] == answered

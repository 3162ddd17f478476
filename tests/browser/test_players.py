"""Play pages of motions in a real browser: what is out of view stays unread, one clock, the keyboard."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kinema.motion.view.html import save_html
from kinema.types import Motion

FIRST = "document.querySelector('.kinema-player').kinema"
CLOCKS = "[...kinema.players].map(p => p.state.time)"


@pytest.fixture
def motions(walker) -> list[Motion]:
    return [replace(walker, text=f"person {i}") for i in range(30)]


def painted(browser, selector: str) -> bool:
    """Say whether a canvas shows anything."""
    return browser.js(
        f"(c => c.getContext('2d').getImageData(0, 0, c.width, c.height).data.some(v => v))"
        f"(document.querySelector('{selector}'))"
    )


def test_a_motion_plays(browser, motions, tmp_path):
    browser.open(save_html(motions, tmp_path / "page.html"))
    browser.until(f"{FIRST}.tracks")
    before = browser.js(f"{FIRST}.state.time")
    browser.until(f"{FIRST}.state.time !== {before}")
    assert painted(browser, ".kinema-player canvas")
    browser.js("document.querySelector('[data-action=play]').click()")
    held = browser.js(f"{FIRST}.state.time")
    browser.js("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    assert browser.js(f"{FIRST}.state.time") == held


def test_what_is_out_of_view_is_read_when_it_comes_into_view(browser, motions, tmp_path):
    browser.open(save_html(motions, tmp_path / "page.html"))
    browser.until(f"{FIRST}.tracks")
    assert browser.js("[...kinema.players].filter(p => p.tracks).length") < len(motions)
    last = "[...kinema.players].at(-1)"
    assert browser.js(f"{last}.tracks === undefined")
    browser.js(f"{last}.figure.scrollIntoView()")
    browser.until(f"{last}.tracks")
    browser.until(f"{FIRST}.canvas.width === 0")  # and what went out of view holds no pixels


def test_one_clock_for_all(browser, motions, tmp_path):
    browser.open(save_html(motions[:4], tmp_path / "page.html"))
    browser.js("document.querySelector('[data-action=sync]').click()")
    browser.until(f"new Set({CLOCKS}).size === 1 && {CLOCKS}[0] > 0")
    browser.js(
        "{const s = document.querySelector('.kinema-controls input');"
        " s.value = 25; s.dispatchEvent(new Event('input'))}"
    )
    assert browser.js(CLOCKS) == [1.25] * 4
    browser.js(
        "{const s = document.querySelector('[data-action=seek]');"
        " s.value = 1; s.dispatchEvent(new Event('input', {bubbles: true}))}"
    )
    assert browser.js(CLOCKS) == pytest.approx([59 / 20] * 4)


def test_the_keyboard_plays_and_steps(browser, motions, tmp_path):
    browser.open(save_html(motions[:2], tmp_path / "page.html"))
    browser.until(f"{FIRST}.tracks")
    browser.js("document.querySelector('.kinema-player canvas').focus()")
    playing = browser.js(f"{FIRST}.state.playing")
    browser.press(" ")
    assert browser.js(f"{FIRST}.state.playing") is not playing
    browser.js(f"{FIRST}.step(0)")
    frame = browser.js(f"{FIRST}.frame")
    browser.press("ArrowRight")
    assert browser.js(f"{FIRST}.frame") == pytest.approx(min(frame + 1, 59))


def test_a_foot_that_stands_is_marked_and_one_that_glides_is_not(browser, motions, tmp_path):
    joints = motions[0].joints * np.float32([1, 1, 2])  # glides by 1.6 m/s, and then stands
    held = replace(motions[0], joints=np.concatenate([joints[:30], np.repeat(joints[30:31], 30, axis=0)]))
    browser.open(save_html([held], tmp_path / "page.html"))
    browser.until(f"{FIRST}.tracks")
    green = (
        "(({data}) => data.filter((red, i) => i % 4 === 0 && data[i + 1] > red + 60 && data[i + 1] > data[i + 2] + 30)"
        f".length)((c => c.getContext('2d').getImageData(0, 0, c.width, c.height))({FIRST}.canvas))"
    )
    browser.js(f"kinema.playAll(false); {FIRST}.seek(10)")
    browser.drawn()
    assert browser.js(green) == 0
    browser.js(f"{FIRST}.seek(50)")
    browser.drawn()
    assert browser.js(green) > 50


def test_what_stands_still_is_not_drawn_again(browser, motions, tmp_path):
    browser.open(save_html(motions[:1], tmp_path / "page.html"))
    browser.until(f"{FIRST}.tracks")
    browser.js(f"kinema.playAll(false); {FIRST}.seek(10)")
    browser.drawn()
    browser.js("{const draw = kinema.draw; window.times = 0; kinema.draw = (...a) => { window.times++; draw(...a); }}")
    browser.drawn()
    assert browser.js("window.times") == 0
    browser.js(f"{FIRST}.state.view.turn += 1")
    browser.drawn()
    assert browser.js("window.times") == 1


def test_an_edit_shows_what_was_kept(browser, motions, tmp_path):
    kept = np.arange(60) < 20
    browser.open(save_html([replace(motions[0], kept=kept)], tmp_path / "page.html"), dark=True)
    browser.until(f"{FIRST}.tracks")
    browser.js(f"kinema.playAll(false); {FIRST}.seek(0)")
    browser.until(f"{FIRST}.clock.value.startsWith('kept')")
    browser.js(f"{FIRST}.seek(40)")
    browser.until(f"{FIRST}.clock.value.startsWith('generated')")
    assert "linear-gradient" in browser.js(f"{FIRST}.slider.style.backgroundImage")

"""Use the site of reports in a real browser, from file://: sort a table, compare methods in step, open many motions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kinema.report.index import write_site
from kinema.report.site import render
from kinema.types import Motion

NASTY = "</script><script>alert(1)</script><img src=x onerror='alert(2)'>"
COLUMNS = [
    {"key": "r1", "label": "R@1", "better": "higher", "digits": 2},
    {"key": "fid", "label": "FID", "better": "lower", "digits": 2},
]
FID = "table.sortable th:nth-child(4) button"
ROWS = "[...document.querySelector('table.sortable').tBodies[0].rows].map(r => r.cells[0].firstChild.textContent)"
GALLERY = "document.querySelector('.kinema-gallery')"
SHOWN = "[...document.querySelectorAll('.kinema-prompts .kinema-player')].map(f => f.kinema)"


def row(key: str, kind: str, fid: float | None, paper: float | None) -> dict:
    results = [] if fid is None else [{"r1": 0.5, "fid": fid}, {"r1": 0.6, "fid": fid + 0.1}]
    published = None if paper is None else {"fid": [paper, 0.004]}
    return {"key": key, "label": key, "kind": kind, "published": published, "results": results}


@pytest.fixture(scope="module")
def table() -> dict:
    rows = [row("real", "real", 0.0, None), row("b", "method", 3.0, 0.1), row("a", "method", 1.0, 0.3)]
    run = {
        "name": "sit",
        "stage": "generator",
        "rows": ["a", NASTY],
        "judge": False,
        "facts": {"seed": 0, "parameters": 1234567},
        "config": {"caption": NASTY},
        "curves": {"val/loss": [[1, 0.5], [2, 0.25]], "train/loss": [[1, 0.9], [2, 0.1]]},
    }
    return {
        "name": "t",
        "title": f"Table {NASTY}",
        "columns": COLUMNS,
        "rows": [*rows, row(NASTY, "method", 2.0, None), row("c", "method", None, 0.2)],
        "corpus": "open_mocap",
        "scale": "tiny",
        "runs": [run],
    }


@pytest.fixture(scope="module")
def site(table, walker, tmp_path_factory) -> Path:
    """Make a site of two tables; the rows of the second are edits of real motion."""
    folder = tmp_path_factory.mktemp("reports")
    texts = ["walk", NASTY, "walk"]

    def motions(shift: float, kept: np.ndarray | None = None) -> list[Motion]:
        joints = walker.joints + np.float32([shift, 0, 0])
        return [replace(walker, joints=joints[: 60 - 10 * i], text=t, kept=kept) for i, t in enumerate(texts)]

    labels = ["real", "b", "a", NASTY]
    render(table, folder / "one", {label: motions(i) for i, label in enumerate(labels)})
    kept = np.arange(60) < 20
    edits = {"real": motions(0), "b": [replace(m, kept=kept[: len(m.joints)]) for m in motions(0.5)]}
    render({**table, "title": "Edits"}, folder / "two", edits)
    write_site(folder)
    return folder


@pytest.mark.parametrize("name", ["index.html", "gallery.html", "one/index.html", "two/index.html"])
@pytest.mark.parametrize("dark", [False, True])
def test_every_page_opens_and_fits_a_narrow_screen(browser, site, name, dark):
    browser.open(site / name, width=400, dark=dark)
    assert browser.js("document.documentElement.scrollWidth <= innerWidth")
    assert browser.js("document.querySelectorAll('img').length") == 0  # what a label holds is text
    light = browser.js("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert light is not dark


def test_a_table_sorts_by_mouse_and_keyboard(browser, site):
    browser.open(site / "one" / "index.html")
    as_written = browser.js(ROWS)
    browser.js(f"document.querySelector('{FID}').click()")
    assert browser.js(ROWS) == ["real", "a", NASTY, "b", "c"]  # the best first, the row without a number last
    assert browser.js(f"document.querySelector('{FID}').closest('th').ariaSort") == "ascending"
    browser.js(f"document.querySelector('{FID}').focus()")
    browser.press("Enter")
    assert browser.js(ROWS) == ["b", NASTY, "a", "real", "c"]
    assert browser.js(f"document.querySelector('{FID}').closest('th').ariaSort") == "descending"
    browser.press(" ")
    assert browser.js(ROWS) == as_written
    browser.js("document.querySelector('caption input').click()")
    browser.press("Enter")
    assert browser.js(ROWS)[:3] == ["b", "c", "a"]  # by the paper's numbers


def test_methods_play_in_step_and_over_each_other(browser, site):
    browser.open(site / "gallery.html")
    browser.until(f"{SHOWN}.slice(0, 3).every(p => p.tracks)")
    assert browser.js("kinema.settings.sync")
    assert browser.js("document.querySelectorAll('.kinema-group').length") == 3  # two prompts, one of them of two clips
    browser.js("document.querySelectorAll('.kinema-choice legend button:last-child').forEach(b => b.click())")
    assert browser.js(f"{SHOWN}.length") == 0
    browser.js(
        "document.querySelector('.kinema-choice fieldset').querySelectorAll('label')"
        ".forEach(label => ['a', 'b'].includes(label.textContent.trim()) && label.control.click())"
    )
    assert browser.js(f"{SHOWN}.length") == 6
    browser.js("kinema.playAll(true)")
    browser.until("kinema.shared.time > 0.1")
    assert browser.js(f"new Set({SHOWN}.map(p => p.state.time)).size") == 1
    browser.js("document.querySelector('.kinema-overlay').focus()")
    browser.press(" ")
    browser.until(f"{SHOWN}.length === 3 && {SHOWN}[0].tracks?.length === 2")
    assert browser.js(f"{SHOWN}[0].tracks.map(t => t.label).sort()") == ["a", "b"]
    browser.js(f"kinema.playAll(false); {SHOWN}[0].seek(30)")
    assert browser.js(f"{SHOWN}.every(p => p.state.time === 1.5)")


def test_edits_are_shown_in_two_colours(browser, site):
    browser.open(site / "two" / "index.html")
    browser.js(f"{GALLERY}.scrollIntoView()")
    browser.until(f"window.edit = {SHOWN}.find(p => p.tracks?.[0].kept.length)")
    orange = (
        "(({data}) => data.filter((red, i) => i % 4 === 0 && red > data[i + 2] + 60).length)"
        "(edit.canvas.getContext('2d').getImageData(0, 0, edit.canvas.width, edit.canvas.height))"
    )
    browser.js("kinema.settings.trail = false; kinema.playAll(false); edit.seek(0)")
    browser.drawn()  # the clock may say "kept" of an earlier frame, whose trail is still seen
    assert browser.js("edit.clock.value").startswith("kept")
    assert browser.js(orange) == 0
    browser.js("edit.seek(40)")
    browser.drawn()
    assert browser.js("edit.clock.value").startswith("generated")
    assert browser.js(orange) > 100


def test_prompts_are_found(browser, site):
    browser.open(site / "gallery.html")
    browser.js("{const box = document.querySelector('input[type=search]');"
               " box.value = 'ALERT'; box.dispatchEvent(new Event('input'))}")  # fmt: skip
    assert browser.js("[...document.querySelectorAll('.kinema-group')].map(h => h.textContent)") == [NASTY]


def test_a_page_of_300_motions_reads_those_in_view(browser, table, walker, tmp_path):
    rows = [row(f"m{i}", "method", 1.0 + i, None) for i in range(50)]
    motions = [replace(walker, text=f"prompt {i}") for i in range(6)]
    shifted = {
        f"m{i}": [replace(m, joints=m.joints + np.float32([0.01 * i, 0, 0])) for m in motions] for i in range(50)
    }
    render({**table, "rows": rows}, tmp_path / "many", shifted)
    browser.open(tmp_path / "many" / "index.html")
    assert browser.js(f"{SHOWN}.length") == 300
    assert (tmp_path / "many" / "index.html").stat().st_size < 300_000  # the motions lie beside it
    browser.js(f"{GALLERY}.scrollIntoView()")
    browser.until(f"{SHOWN}[0].tracks")
    assert browser.js(f"{SHOWN}.filter(p => p.tracks).length") < 30
    assert len([url for url in browser.asked if "/motions/" in url]) < 30


def test_a_motion_that_cannot_be_read_says_so(chromium, table, walker, tmp_path):
    render(table, tmp_path / "lost", {"a": [walker]})
    next((tmp_path / "lost" / "motions").iterdir()).unlink()
    chromium.open(tmp_path / "lost" / "index.html")
    chromium.js(f"{GALLERY}.scrollIntoView()")
    chromium.until("document.querySelector('.kinema-broken')?.textContent.includes('cannot be read')")

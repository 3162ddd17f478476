"""`kinema gallery` shows files of any kind on one page: titles, one clock, the keyboard, many of them at once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kinema import cli
from kinema.motion.export import save
from kinema.text import manifest
from kinema.text.manifest import Entry

PLAYERS = "[...document.querySelectorAll('.kinema-player')].map(f => f.kinema)"
CLOCKS = f"{PLAYERS}.map(p => p.state.time)"
ENTRY = Entry(
    "", "a man bows", 7, 60, "asked", 20.0, 1, None, "humanml3d", "run", "0", "MARDM", {}, False, 1, "cpu", {}
)


@pytest.fixture
def files(walker, tmp_path) -> list[Path]:
    """Write a motion as .npz, .npy and .bvh; a manifest says what the last is, and of a file that is gone."""
    walker = replace(walker, joints=walker.joints[:40], features=walker.features[:40])
    (tmp_path / "made").mkdir()
    named = ["walk.npz", "walk.npy", "made/bow.bvh"]
    files = [save(walker, tmp_path / name) for name in named]
    manifest.add(tmp_path / "made", [replace(ENTRY, file="bow.bvh"), replace(ENTRY, file="gone.bvh")])
    return files


@pytest.fixture
def page(files, tmp_path, capsys) -> Path:
    out = tmp_path / "page.html"
    named = [*map(str, files[:2]), str(tmp_path / "made" / "manifest.jsonl")]
    assert cli.main(["gallery", *named, "--out", str(out)]) == 0
    assert "note: 1 files that" in capsys.readouterr().out
    return out


@pytest.mark.parametrize("dark", [False, True])
def test_a_page_of_files_has_their_texts_and_fits_a_narrow_screen(browser, page, dark):
    browser.open(page, width=400, dark=dark)
    assert browser.js("document.documentElement.scrollWidth <= innerWidth")
    labels = "[...document.querySelectorAll('.kinema-label')].map(l => l.textContent)"
    assert browser.js(labels) == ["walk.npz", "walk.npy", "made/bow.bvh"]
    texts = browser.js("[...document.querySelectorAll('figcaption')].map(l => l.textContent)")
    assert "walk" in texts[0]
    assert "a man bows" in texts[2]
    assert "seed 7" in texts[2]
    assert (browser.js("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)") is not dark


def test_motions_play_in_step_and_are_scrubbed_together(browser, page):
    browser.open(page)
    browser.until(f"{PLAYERS}.every(p => p.tracks)")
    browser.until(f"new Set({CLOCKS}).size === 1 && {CLOCKS}[0] > 0")
    browser.js(f"{PLAYERS}[1].canvas.focus(); kinema.playAll(true)")
    browser.press(" ")
    assert browser.js(f"{PLAYERS}.every(p => !p.state.playing)")
    browser.js(
        "{const s = document.querySelector('[data-action=seek]');"
        " s.value = 0.5; s.dispatchEvent(new Event('input', {bubbles: true}))}"
    )
    (clock,) = set(browser.js(CLOCKS))
    assert clock == pytest.approx(39 / 20 / 2)
    browser.press("ArrowRight")
    assert set(browser.js(CLOCKS)) == {1.05}


def test_takes_of_a_text_stand_below_it(browser, walker, tmp_path):
    takes = [save(replace(walker, text="ab"[i % 2], seed=i), tmp_path / f"{i}.npz") for i in range(4)]
    assert cli.main(["gallery", *map(str, takes), "--out", str(tmp_path / "page.html")]) == 0
    browser.open(tmp_path / "page.html")
    assert browser.js("[...document.querySelectorAll('.kinema-group')].map(h => h.textContent)") == ["a", "b"]
    labels = "[...document.querySelectorAll('.kinema-label')].map(l => l.textContent)"
    assert browser.js(labels) == ["0.npz", "2.npz", "1.npz", "3.npz"]


def test_of_300_motions_those_in_view_are_read(browser, walker, tmp_path):
    files = []
    for i in range(300):
        files.append(tmp_path / f"{i}.npy")
        np.save(files[-1], walker.joints)
    assert cli.main(["gallery", *map(str, files), "--out", str(tmp_path / "page.html")]) == 0
    browser.open(tmp_path / "page.html")
    browser.until(f"{PLAYERS}[0].tracks")
    assert browser.js(f"{PLAYERS}.length") == 300
    assert browser.js(f"{PLAYERS}.filter(p => p.tracks).length") < 30


def test_what_cannot_be_shown_is_named(files, tmp_path, capsys):
    def fails(words: list[str], message: str) -> None:
        assert cli.main(["gallery", *words]) == 2
        assert message in capsys.readouterr().err

    page = str(tmp_path / "page.html")
    fails([str(files[0]), "--out", "page.npz"], "--out page.npz is a page of players")
    fails(["none.npz", "--out", page], "none.npz")
    files[2].unlink()
    fails([str(tmp_path / "made" / "manifest.jsonl"), "--out", page], "the files that the manifest names are gone")
    assert not Path(page).exists()


def test_a_manifest_of_somebody_elses_beside_a_file_is_none(files, tmp_path):
    (tmp_path / "manifest.jsonl").write_text('{"audio_filepath": "x.wav"}\n')
    assert cli.main(["gallery", str(files[0]), "--out", str(tmp_path / "page.html")]) == 0

"""The site holds what table.json and page.json hold, escapes all of it, and says what the numbers can't say."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from kinema.motion.skeleton import HUMANML3D
from kinema.report.cards import limits
from kinema.report.gallery import inert
from kinema.report.index import write_site
from kinema.report.plots import Axis, curves
from kinema.report.sections import sections_page
from kinema.report.site import render
from kinema.types import Motion

NASTY = "</script><img src=x onerror='a'>\"'&<b>"
COLUMNS = [{"key": "fid", "label": "FID", "better": "lower", "digits": 2}]


class Tags(HTMLParser):
    """Collect the tags of a page, and the addresses that it leads to."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.links: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.links += [value for name, value in attrs if name in ("href", "src")]


def table_of(word: str) -> dict:
    results = [{"fid": 1.0}, {"fid": 1.5}]
    row = {"key": word, "label": word, "kind": "method", "note": word, "published": {"fid": 2.0}, "results": results}
    other = {**row, "key": "other", "published": None}
    run = {
        "name": word,
        "stage": word,
        "rows": [word],
        "judge": False,
        "facts": {word: word, "seed": 0},
        "config": {word: {word: word}},
        "curves": {"val/loss": [[0, 1.0], [5, 0.5]], word: [[0, 2.0]]},
    }
    return {
        "name": "t",
        "title": word,
        "columns": [{**COLUMNS[0], "label": word}],
        "rows": [row, other],
        "corpus": word,
        "scale": word,
        "footnotes": [word],
        "effects": [{"what": word, "row": word, "than": "other", "columns": ["fid"]}],
        "provenance": {word: word},
        "runs": [run],
        "breakdowns": [{"title": word, "columns": COLUMNS, "rows": [row]}],
    }


def page_of(word: str) -> dict:
    section = {"name": "part", "title": word, "text": word, "image": "", "rows": [{word: word, "x": 0.5, "n": 3}]}
    return {"title": word, "lead": word, "sections": [section], "provenance": {word: word}}


def site_of(word: str, folder) -> dict[str, str]:
    joints = np.random.default_rng(0).normal(size=(12, 22, 3)).astype(np.float32)
    motion = Motion(joints, np.zeros((12, 0), np.float32), word, HUMANML3D.name, HUMANML3D.fps)
    render(table_of(word), folder / "table", {word: [motion]})
    (folder / "measured").mkdir()
    (folder / "measured" / "page.json").write_text(json.dumps(page_of(word)))
    (folder / "figure").mkdir()
    (folder / "figure" / "figure.md").write_text("a figure")
    return {str(path.relative_to(folder)): path.read_text() for path in write_site(folder)}


def test_nothing_that_a_report_says_can_inject(tmp_path):
    (tmp_path / "plain").mkdir(), (tmp_path / "nasty").mkdir()
    plain, nasty = site_of("plain", tmp_path / "plain"), site_of(NASTY, tmp_path / "nasty")
    assert set(plain) == {"index.html", "gallery.html", "table/index.html", "measured/index.html"}
    for name, text in nasty.items():
        assert Tags(text).tags == Tags(plain[name]).tags, name


def test_every_link_leads_to_a_file_of_the_site(tmp_path):
    for name, text in site_of("word", tmp_path).items():
        links = [link for link in Tags(text).links if not link.startswith("#")]
        assert links or name == "index.html"
        for link in links:
            if link != "part.csv":  # which the page's own writer writes
                assert ((tmp_path / name).parent / link).resolve().is_file(), (name, link)


def test_pages_run_their_own_script_and_nothing_else(tmp_path):
    for name, text in site_of(NASTY, tmp_path).items():
        policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', text)[1]
        assert policy.startswith("default-src 'none'"), name
        assert "unsafe-inline" not in policy.split("script-src")[1], name
        assert not re.findall(r"https?://|@import|url\(|<link", text), name


def test_a_site_made_twice_is_the_same(tmp_path):
    first = site_of("word", tmp_path)
    assert {str(path.relative_to(tmp_path)): path.read_text() for path in write_site(tmp_path)} == first


def test_an_empty_or_damaged_folder_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="kinema reproduce"):
        write_site(tmp_path / "nothing")
    (tmp_path / "table5").mkdir()
    (tmp_path / "table5" / "table.json").write_text("{")
    with pytest.raises(ValueError, match=r"table5/table\.json is damaged"):
        write_site(tmp_path)


def test_limits_are_said():
    table = {**table_of("word"), "corpus": "open_mocap", "scale": "tiny"}
    said = " ".join(limits(table))
    for part in ("corpus is open_mocap", "scale is tiny", "One training seed (0)", "At most 2 replications"):
        assert part in said
    assert "CLIP" not in said
    assert "not by the CLIP" in " ".join(limits({**table, "provenance": {"text encoder": ["minilm"]}}))
    paper = {**table, "corpus": "humanml3d", "scale": "paper", "runs": []}
    assert limits(paper) == ["At most 2 replications a row, where the papers have 20."]


def test_json_in_a_page_is_inert_and_whole():
    assert not set("<>&") & set(inert([NASTY]))
    assert json.loads(inert([NASTY])) == [NASTY]


def test_an_axis_spans_its_values():
    axis = Axis.over([0.2, 0.8], 100, 200)
    assert 100 < axis(0.2) < axis(0.5) < axis(0.8) < 200
    assert all(100 <= axis(tick) <= 200 for tick in axis.ticks)
    assert 2 <= len(axis.ticks) <= 7
    assert Axis.over([3.0, 3.0], 0, 1)(3.0) == 0.5


def test_a_wide_axis_is_logarithmic_and_zero_lies_at_its_start():
    axis = Axis.over([0.0, 0.1, 100.0], 0, 300, log=True)
    assert axis.log
    assert axis(0.0) == 0
    assert axis(10.0) - axis(1.0) == pytest.approx(axis(1.0) - axis(0.1), abs=0.2)
    assert not Axis.over([-1.0, 0.1, 100.0], 0, 300, log=True).log
    assert not Axis.over([0.1, 100.0], 0, 300).log


def test_a_curve_without_a_finite_point_is_left_out():
    drawn = curves({"val/loss": [[0, 1.0], [9, 0.5]], "train/loss": [[0, float("nan")]]})
    assert "val/loss" in drawn
    assert "train/loss" not in drawn
    assert curves({"val/loss": [[0, float("inf")]]}) == ""


def test_a_page_shows_numbers_that_sort():
    page = sections_page(page_of("word"), "../index.html")
    assert "<td data-ours='0.5'>0.5</td><td data-ours='3'>3</td>" in page
    assert "href='../index.html'" in page

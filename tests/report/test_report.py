"""Check a report's numbers and words: intervals, bold, missing rows, whose corpus, the same bytes again."""

from __future__ import annotations

import copy
import csv
import json
import math
import subprocess
import sys

import numpy as np
import pytest
from scipy import stats

from kinema.motion.skeleton import HUMANML3D
from kinema.report.cells import grid
from kinema.report.intervals import FORMS, Value, measure
from kinema.report.site import render
from kinema.types import Motion

COLUMNS = [
    {"key": "r1", "label": "R@1", "better": "higher", "digits": 3},
    {"key": "fid", "label": "FID", "better": "lower", "digits": 2},
]


def row(key: str, kind: str, results: list | None, published: dict | None = None) -> dict:
    return {"key": key, "label": key.upper(), "kind": kind, "published": published, "results": results}


def runs(r1: list[float], fid: list[float]) -> list[dict]:
    return [{"r1": a, "fid": b} for a, b in zip(r1, fid, strict=True)]


@pytest.fixture
def table() -> dict:
    return {
        "name": "table5",
        "title": "Table <5>",
        "columns": COLUMNS,
        "rows": [
            row("real", "real", runs([0.90, 0.92], [0.0, 0.0])),
            row("a", "method", runs([0.50, 0.52], [1.0, 1.1]), {"r1": [0.5, 0.004], "fid": 0.114}),
            row("b_%", "method", runs([0.51, 0.53], [3.0, 3.1])),
            row("c", "method", [], {"r1": [0.47, 0.003]}),
            row("d", "method", None),
            row("e", "method", None) | {"cannot": "it knows no time"},
        ],
        "corpus": "open-mocap",
        "scale": "tiny",
        "provenance": {"evaluator": "abc123", "corpus": {"name": "open-mocap", "hash": "ffee"}, "seeds": [0, 1]},
        "footnotes": ["text encoder: MiniLM"],
    }


def texts(table: dict, folder, motions=None) -> dict[str, str]:
    return {path.name: path.read_text() for path in render(table, folder, motions)}


def test_a_value_of_fewer_replications_than_its_row_says_so(table, tmp_path):
    table["rows"][1]["results"].append({"r1": 0.54})
    (cell, short) = grid(table).lines[1].cells
    assert (cell.ours.text(2), short.ours.text(2)) == ("0.52 ± 0.05", "1.05 ± 0.64 (n = 2)")
    table["rows"][1]["results"] = [{"r1": 0.5}, {"r1": 0.5, "fid": 1.0}]
    assert grid(table).lines[1].cells[1].ours.text(2) == "1.00 (n = 1)"
    assert "1.00 (n = 1)" in texts(table, tmp_path)["table.md"]


def test_interval_of_few_replications_is_students():
    values = [0.50, 0.52, 0.49, 0.55]
    value = measure(values)
    assert value.mean == pytest.approx(np.mean(values))
    low, high = stats.t.interval(0.95, 3, loc=np.mean(values), scale=stats.sem(values))
    assert value.half == pytest.approx((high - low) / 2)
    assert measure([]) is None
    assert measure([0.5]).text(3) == "0.500"  # one replication: no interval, not an interval of zero
    assert measure([0.5, math.nan]).text(3) == "not finite"


@pytest.mark.parametrize(("count", "form"), [(4, "published"), (20, "published"), (20, "student")])
def test_interval_is_the_published_formula(count, form):
    values = np.random.default_rng(0).normal(size=count).tolist()
    assert measure(values, form).half == pytest.approx(1.96 * np.std(values) / math.sqrt(count))


def test_few_replications_cover_the_mean_as_often_as_said():
    draws = np.random.default_rng(1).normal(size=(4000, 5)).tolist()
    covered = {form: np.mean([abs((v := measure(row, form)).mean) <= v.half for row in draws]) for form in FORMS}
    assert covered["student"] == pytest.approx(0.95, abs=0.015)
    assert covered["published"] < 0.86


def test_interval_is_not_rounded_to_nothing():
    assert Value(72.6, 0.001).text(1) == "72.6 ± 0.001"
    assert Value(72.6, 0.0).text(1) == "72.6 ± 0.0"
    assert Value(0.0, 3e-7).text(3) == "0.000 ± 0.000"  # float32's zero


def test_table_says_how_its_intervals_are_computed(table, tmp_path):
    assert "Student's t for n < 20" in texts(table, tmp_path)["table.md"]
    table["intervals"] = "published"
    assert "(1.96 std / √n; one" in texts(table, tmp_path)["index.html"]
    table["intervals"] = "wide"
    with pytest.raises(ValueError, match="intervals='wide'; allowed: student, published"):
        texts(table, tmp_path)


def test_all_formats_hold_ours_and_the_papers(table, tmp_path):
    files = texts(table, tmp_path)
    assert list(files) == ["table.md", "table.csv", "table.tex", "table.json", "index.html"]
    assert "| A | 2 | 0.510 ± 0.127 |" in files["table.md"]
    assert "*0.500 ± 0.004* | *0.11*" in files["table.md"]
    assert r"\usepackage{booktabs}" in files["table.tex"]  # what \toprule is of
    assert r"A & 2 & $0.510 \pm 0.127$" in files["table.tex"]
    assert r"B\_\%" in files["table.tex"]
    assert "0.510<i> ± 0.127</i>" in files["index.html"]
    assert "Table &lt;5&gt;" in files["index.html"]
    lines = {line["key"]: line for line in csv.DictReader(files["table.csv"].splitlines())}
    assert float(lines["a"]["r1"]) == pytest.approx(0.51)
    assert float(lines["a"]["r1_paper_half"]) == 0.004
    assert lines["c"]["r1"] == ""
    assert lines["c"]["r1_paper"] == "0.47"


def test_bold_only_where_intervals_are_apart(table):
    best = {(line.key, i) for line in grid(table, mark_best=True).lines for i, c in enumerate(line.cells) if c.best}
    assert best == {("a", 1)}  # R@1 overlaps; the real row does not compete
    table["rows"][1]["results"] = table["rows"][1]["results"][:1]  # no interval, no claim
    assert not any(c.best for line in grid(table, mark_best=True).lines for c in line.cells)


def test_a_table_of_several_judges_marks_no_best_and_speaks_of_none(table, tmp_path):
    assert "Bold: the best" in texts(table, tmp_path)["table.md"]
    table["mark_best"] = False
    files = texts(table, tmp_path)
    assert "Bold" not in files["table.md"] + files["index.html"]
    assert "**" not in files["table.md"]


def test_a_value_above_its_columns_bound_is_marked_and_the_mark_explained(table, tmp_path):
    bound = {"above": 0.505, "means": "better than <real>"}
    table["columns"] = [{**COLUMNS[0], "flag": bound}, COLUMNS[1]]
    files = texts(table, tmp_path)
    assert "| A | 2 | 0.510 ± 0.127 † |" in files["table.md"]
    assert "| B_% | 2 | 0.520 ± 0.127 † |" in files["table.md"]
    assert "† above 0.505: better than <real>." in files["table.md"]
    assert r"$0.510 \pm 0.127^{\dagger}$" in files["table.tex"]
    assert "<sup title='better than &lt;real&gt;'>†</sup>" in files["index.html"]
    assert "<p class='small'>† above 0.505: better than &lt;real&gt;.</p>" in files["index.html"]
    assert "†" not in files["table.csv"]
    table["breakdowns"] = [{"title": "Beside", "columns": table["columns"], "rows": [table["rows"][1]]}]
    table["columns"] = COLUMNS
    files = texts(table, tmp_path)
    for text in (files["table.md"], files["index.html"]):
        assert text.count("† above 0.505") == 1
    bound["above"] = 2
    assert "†" not in "".join(texts(table, tmp_path).values())


def test_missing_rows_say_so(table, tmp_path):
    files = texts(table, tmp_path)
    assert "| C | not yet run |  |  |" in files["table.md"]
    assert "| D | not in Kinema yet |  |  |" in files["table.md"]
    assert "| E | cannot |  |  |" in files["table.md"]
    assert "E: it knows no time" in files["table.md"]
    for text in (files["table.md"], files["index.html"]):
        assert "Not yet run: C." in text
        assert "Not in Kinema yet: D." in text


@pytest.mark.parametrize(
    ("corpus", "panel", "comparable", "expected"),
    [
        ("open-mocap", "humanml3d", False, "tiny. The paper's numbers are HumanML3D results and are not comparable"),
        ("synthetic_kit", "kit_ml", False, "The paper's numbers are KIT-ML results and are not comparable"),
        ("synthetic_kit", None, False, "Corpus: synthetic_kit; scale: tiny. The paper has no numbers of such motion."),
        ("kit_ml", "kit_ml", False, "numbers are KIT-ML results of full-size training and are not comparable"),
        ("humanml3d", "humanml3d", True, "Corpus: HumanML3D; scale: tiny. The paper's numbers are of the same corpus."),
        (None, "humanml3d", False, "Corpus: not recorded"),
    ],
)
def test_corpus_is_named(table, tmp_path, corpus, panel, comparable, expected):
    files = texts({**table, "corpus": corpus, "panel": panel, "comparable": comparable}, tmp_path)
    assert expected in files["table.md"]
    assert expected in files["table.tex"]
    assert expected.replace("'", "&#x27;") in files["index.html"]


def test_provenance_and_breakdowns(table, tmp_path):
    table["breakdowns"] = [
        {"title": "By source", "columns": COLUMNS[:1], "rows": [row("a: cmu", "method", [{"r1": 0.25, "n": 3}])]},
        {"title": "By nothing", "columns": COLUMNS, "rows": []},
    ]
    files = texts(table, tmp_path)
    facts = ["- corpus.hash: `ffee`", "- corpus.name: `open-mocap`", "- evaluator: `abc123`", "- seeds: `0; 1`"]
    assert "\n".join(facts) in files["table.md"]
    assert "<dt>corpus.hash</dt><dd>ffee</dd>" in files["index.html"]
    assert "## By source" in files["table.md"]
    assert "| A: CMU | 1 | 0.250 |" in files["table.md"]
    assert "By nothing" not in files["table.md"]


def test_same_input_gives_the_same_bytes(table, tmp_path, motions):
    shuffled = copy.deepcopy(table)
    shuffled["provenance"] = dict(reversed(table["provenance"].items()))
    first, second = render(table, tmp_path / "a", motions), render(shuffled, tmp_path / "b", motions)
    assert [p.read_bytes() for p in first] == [p.read_bytes() for p in second]


@pytest.fixture
def motions() -> dict[str, list[Motion]]:
    def make(text: str, seed: int) -> Motion:
        joints = np.random.default_rng(seed).normal(size=(40, 22, 3)).astype(np.float32)
        return Motion(joints, np.zeros((40, 0), np.float32), text, HUMANML3D.name, HUMANML3D.fps, seed)

    return {"b_%": [make("walk", 0), make("jump", 1)], "a": [make("jump", 2), make("walk", 3)]}


def test_motions_lie_beside_the_page_and_are_named_in_it(table, tmp_path, motions):
    files = texts(table, tmp_path, motions)
    packs = json.loads(files["table.json"])["motions"]
    assert set(packs) == {"a", "b_%"}
    assert [m["text"] for m in packs["a"]["motions"]] == ["jump", "walk"]
    for key, pack in packs.items():
        assert pack["pack"] in files["index.html"]
        script = (tmp_path / pack["pack"]).read_text()
        played = json.loads(script.removeprefix("kinema.pack(").removesuffix(");\n"))
        assert [len(motion["parents"]) for motion in played] == [22, 22], key
    assert "http" not in files["index.html"].replace("http-equiv", "")


def test_packs_that_no_row_has_any_more_are_deleted(table, tmp_path, motions):
    render(table, tmp_path, motions)
    first = {path.name for path in (tmp_path / "motions").iterdir()}
    render(table, tmp_path, {"a": motions["b_%"]})
    (left,) = (tmp_path / "motions").iterdir()
    assert left.name in first


def test_a_motion_that_is_not_finite_says_so(table, tmp_path, motions):
    motions["a"][1].joints[7:, 3] = np.nan
    packs = json.loads(texts(table, tmp_path, motions)["table.json"])["motions"]
    assert [m["broken"] for m in packs["a"]["motions"]] == [None, 7]


def test_bad_tables_are_named(table, tmp_path, motions):
    with pytest.raises(ValueError, match="'zzz', which is no row of the table; rows: real, a"):
        render(table, tmp_path, {"zzz": motions["a"]})
    with pytest.raises(ValueError, match="kind is 'baseline', it should be one of real, control, method"):
        render({**table, "rows": [row("x", "baseline", [])]}, tmp_path)
    with pytest.raises(ValueError, match="better is 'up'"):
        render({**table, "columns": [{**COLUMNS[0], "better": "up"}]}, tmp_path)
    with pytest.raises(ValueError, match="two rows of the table have the key 'x'"):
        render({**table, "rows": [row("x", "method", []), row("x", "method", [])]}, tmp_path)
    assert not list(tmp_path.iterdir())


def test_rendering_needs_no_torch():
    code = "import sys, kinema.report.site; sys.exit('torch' in sys.modules or 'hydra' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=120).returncode == 0

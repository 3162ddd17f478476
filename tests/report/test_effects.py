"""An effect is a paired difference; its verdict follows from its interval and the paper's sign."""

from __future__ import annotations

import csv
import math

import pytest
from scipy import stats

from kinema.report.cells import grid
from kinema.report.effects import effects
from kinema.report.site import render

FID = {"key": "fid", "label": "FID", "better": "lower", "digits": 2}


def table(more: list[float], less: list[float], paper: tuple[float, float] | None = (1.0, 0.4)) -> dict:
    published = [None, None] if paper is None else [{"fid": value} for value in paper]
    rows = [
        {"key": key, "label": key, "kind": "method", "published": numbers, "results": [{"fid": v} for v in values]}
        for key, values, numbers in (("with", more, published[0]), ("without", less, published[1]))
    ]
    spec = {"what": "redundancy <helps>", "row": "with", "than": "without", "columns": ["fid"]}
    return {"name": "t", "title": "T", "columns": [FID], "rows": rows, "effects": [spec]}


def effect(*args, **kwargs):
    described = table(*args, **kwargs)
    (found,) = effects(described, grid(described))
    return found


def test_difference_is_paired_by_replication():
    more, less = [1.0, 2.0, 3.0], [0.9, 1.8, 2.9]
    found = effect(more, less)
    low, high = stats.t.interval(0.95, 2, loc=0.4 / 3, scale=stats.sem([0.1, 0.2, 0.1]))
    assert found.ours.mean == pytest.approx(0.4 / 3)
    assert found.ours.half == pytest.approx((high - low) / 2)
    assert found.paper == pytest.approx(0.6)


@pytest.mark.parametrize(
    ("more", "paper", "verdict"),
    [
        ([2.0, 2.1, 2.05], (1.0, 0.4), "as in the paper"),
        ([2.0, 2.1, 2.05], (0.4, 1.0), "opposite to the paper"),
        ([2.0, 2.1, 2.05], None, "not in the paper"),
        ([1.1, 0.9, 1.05], (1.0, 0.4), "no difference to be seen"),
        ([], (1.0, 0.4), "not yet run"),
    ],
)
def test_verdict(more, paper, verdict):
    assert effect(more, [1.0, 1.0, 1.0][: len(more)], paper).verdict == verdict


def test_one_replication_decides_nothing():
    assert effect([2.0], [1.0]).verdict == "one replication decides nothing"


def test_over_seeds_the_evaluation_s_draws_are_told_apart(tmp_path):
    described, gains = table([2.0, 2.2], [1.0, 1.0]), [1.05, 1.1, 1.15]
    for row, draws in zip(described["rows"], ([1.0 + gain for gain in gains], [1.0] * 3), strict=True):
        row |= {"seeds": 2, "draws": [{"fid": value} for value in draws]}
    (found,) = effects(described, grid(described))
    low, high = stats.t.interval(0.95, 2, loc=1.1, scale=stats.sem(gains))
    assert (found.ours.count, found.draws.count) == (2, 3)
    assert found.draws.half == pytest.approx((high - low) / 2)
    assert found.verdict == "no difference to be seen"  # what the seeds say, whatever the draws do
    files = {path.name: path.read_text() for path in render(described, tmp_path)}
    assert "| +1.10 ± 1.27 (draws: +1.10 ± 0.12) | +0.60 |" in files["table.md"]
    assert "over replications, each the mean of these seeds" in files["table.md"]
    (line,) = csv.DictReader(files["effects.csv"].splitlines())
    assert line["draws"] == "3"


def test_rows_of_unequal_replications_are_not_compared():
    assert effect([2.0, 2.1], [1.0]).ours is None


def test_reports_show_the_effect(tmp_path):
    files = {path.name: path.read_text() for path in render(table([2.0, 2.1, 2.05], [1.0, 1.0, 1.0]), tmp_path)}
    assert "| redundancy &lt;helps> | FID ↓ | +1.05 ± 0.12 | +0.60 | as in the paper |" in files["table.md"]
    assert "redundancy &lt;helps&gt;" in files["index.html"]
    assert "<td>+1.05<i> ± 0.12</i></td><td>+0.60</td><td>as in the paper</td>" in files["index.html"]
    (line,) = csv.DictReader(files["effects.csv"].splitlines())
    assert math.isclose(float(line["difference"]), 1.05)
    assert line["verdict"] == "as in the paper"


@pytest.mark.parametrize(
    ("key", "value", "message"), [("than", "witout", "no row 'witout'"), ("columns", ["r9"], "no column 'r9'")]
)
def test_a_wrong_key_is_named(key, value, message):
    described = table([1.0], [1.0])
    described["effects"][0][key] = value
    with pytest.raises(ValueError, match=message):
        effects(described, grid(described))

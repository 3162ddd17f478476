"""The page of noise: the essential evaluator can't mind what it doesn't read, and levels are scored once."""

from __future__ import annotations

import csv

import pytest

from kinema.experiments import pages
from kinema.experiments.config import compose, validate
from kinema.experiments.evaluation import describe
from kinema.experiments.pages import load_page
from kinema.experiments.pages.noise import points
from kinema.experiments.reproduce import reproduce
from kinema.experiments.tables import plan

pytestmark = pytest.mark.usefixtures("unchecked")


def test_levels_are_scored_once_and_an_evaluator_minds_only_what_it_reads(micro, tmp_path, monkeypatch, capsys):
    pytest.importorskip("matplotlib")
    small = load_page("noise")
    small["levels"] = {"add": [0.1, 2.0], "replace": [1.0]}
    monkeypatch.setattr(pages, "load_page", lambda name: small)
    for _ in range(2):
        reproduce("noise", micro, jobs=1, out=tmp_path / "page")
        told = capsys.readouterr().out
    assert "run " not in told
    rows = list(csv.DictReader((tmp_path / "page/levels.csv").open()))
    assert len(rows) == 3 * (1 + 2 * 3)
    fid = {(row["judge"], row["dims"], row["how"], float(row["level"])): float(row["fid"]) for row in rows}
    own, corpus, essential = (judge["label"] for judge in small["judges"])
    unread = [value for (judge, dims, *_), value in fid.items() if (judge, dims) == (essential, "redundant")]
    assert len(unread) == 3
    assert all(value == fid[essential, "", "", 0.0] for value in unread)
    for judge, dims in ((essential, "essential"), (own, "essential"), (own, "redundant"), (corpus, "redundant")):
        assert fid[judge, dims, "add", 2.0] > fid[judge, dims, "add", 0.1] > 0
    # The judge divides the root's deviation by 25: the corpus' is louder to it.
    assert fid[corpus, "essential", "add", 0.1] > fid[own, "essential", "add", 0.1]
    assert (tmp_path / "page/levels.png").read_bytes().startswith(b"\x89PNG")


def test_every_point_is_an_evaluation_of_its_own(micro):
    rows = plan({"rows": list(points(load_page("noise")))}, micro)
    assert len({row.place.folder.path for row in rows}) == len(rows) - 1  # one judge is heard by two measures


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("perturb.space=mine", "perturb.space=mine: must be one of evaluator, corpus"),
        ("perturb.dims=all", "perturb.dims=all: must be one of essential, redundant"),
        ("perturb.how=scale", "perturb.how=scale: must be one of add, replace"),
        ("perturb.level=-1", "perturb.level=-1: must be a finite number >= 0"),
        ("perturb.level=much", "perturb.level=much: must be a finite number"),
    ],
)
def test_a_wrong_option_is_named(micro, override, message):
    with pytest.raises(ValueError, match=message):
        validate(compose([*micro, "source=perturbed", override], "evaluate"))


def test_the_level_is_part_of_a_perturbed_rows_identity_and_of_no_others(micro):
    def place(*overrides):
        return describe(compose([*micro, *overrides], "evaluate")).folder.path

    assert place("source=perturbed", "perturb.level=0.1") != place("source=perturbed", "perturb.level=0.2")
    assert place("source=real", "perturb.level=0.1") == place("source=real", "perturb.level=0.2")

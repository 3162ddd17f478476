"""MARDM Figure 2 by make: the tokenizers of Table 1, found by what they are."""

from __future__ import annotations

import json

import pytest

from kinema.experiments.pages import load_page
from kinema.experiments.pages.subjects import want
from kinema.experiments.reproduce import reproduce
from kinema.experiments.table_files import load_table
from kinema.experiments.tables import plan

pytestmark = pytest.mark.usefixtures("unchecked")


def test_it_counts_the_codes_of_every_tokenizer_once(micro, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    for _ in range(2):
        reproduce("figure2", micro, jobs=1, out=tmp_path)
        told = capsys.readouterr().out
    assert "run " not in told
    runs = json.loads((tmp_path / "code_usage.json").read_text())["runs"]
    assert {(run["tokenizer"], run["dims"]) for run in runs} == {
        (name, dims) for name in ("vq", "rvq") for dims in ("essential", "redundant")
    }
    assert (tmp_path / "code_usage.png").read_bytes().startswith(b"\x89PNG")


def test_its_runs_are_those_of_table_1(micro):
    own = {one.run.path for one in want(load_page("figure2")["tokenizers"], "tokenizer", micro)}
    rows = plan(load_table("table1"), micro)
    assert own == {row.place.subject["tokenizer"] for row in rows if row.cfg.source == "reconstruction"}

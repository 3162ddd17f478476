"""Costs are counted of every part that learns, by its own recipe."""

from __future__ import annotations

import csv

import pytest

from kinema.data.store import PackedStore
from kinema.experiments import pages
from kinema.experiments.config import compose
from kinema.experiments.corpus import open_corpus
from kinema.experiments.pages import load_page
from kinema.experiments.pages.costs import clips, training_step
from kinema.experiments.pages.untrained import untrained
from kinema.experiments.reproduce import reproduce

pytestmark = pytest.mark.usefixtures("unchecked")


def test_every_part_that_learns_is_counted(micro_tables, tmp_path, monkeypatch):
    small = load_page("costs")
    small["methods"] = [spec for spec in small["methods"] if spec["method"] in ("momask", "mdm", "mardm_sit")]
    monkeypatch.setattr(pages, "load_page", lambda name: small)
    reproduce("costs", micro_tables, out=tmp_path / "page")
    rows = list(csv.DictReader((tmp_path / "page/costs.csv").open()))
    assert [(row["method"], row["part"]) for row in rows] == [
        *(("MoMask", part) for part in ("training the tokenizer", "training the generator", "training the residual")),
        ("MoMask", "evaluation"),
        ("MDM-50Step", "training the generator"),
        ("MDM-50Step", "evaluation"),
        *(("MARDM-SiT", part) for part in ("training the tokenizer", "training the generator", "evaluation")),
    ]
    for row in rows:
        hours = float(row["GFLOP"]) * float(row["count"]) / (small["tflops"] * 1e3) / 3600
        assert float(row["GPU hours"]) == pytest.approx(hours, rel=1e-4)
    sampled = [row for row in rows if row["part"] == "evaluation"]
    assert {int(row["count"]) for row in sampled} == {2 * (4640 + 4 * 3)}  # two replications, four texts four times


def test_operations_of_a_step_are_in_proportion_to_the_batch(micro_tables):
    cfg = compose([*micro_tables, "method=mdm"], "evaluate")
    store = PackedStore.open(open_corpus(cfg))
    few, many = clips(store, 2, 64), clips(store, 4, 64)
    model = untrained(cfg, store, many)
    once, twice = (training_step(model, "generator", batch, None) for batch in (few, many))
    assert twice == pytest.approx(2 * once, rel=0.01)

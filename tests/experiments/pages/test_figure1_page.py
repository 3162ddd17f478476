"""FID against size: the models are Table A2's, each counted as it is built."""

from __future__ import annotations

import csv

import pytest

from kinema.experiments.pages import figure1
from kinema.experiments.reproduce import reproduce
from kinema.experiments.table_files import load_table

pytestmark = pytest.mark.usefixtures("unchecked")


def test_models_of_the_scaling_study_are_counted_and_drawn(micro, tmp_path, monkeypatch, capsys):
    pytest.importorskip("matplotlib")
    table = load_table("tablea2")
    small = {**table, "rows": [row for row in table["rows"] if row["key"] in ("real", "s", "m_384", "xl")]}
    monkeypatch.setattr(figure1, "load_table", lambda name: small)
    for _ in range(2):
        reproduce("figure1", micro, jobs=1, out=tmp_path / "page")
        told = capsys.readouterr().out
    assert "run " not in told
    rows = list(csv.DictReader((tmp_path / "page/sizes.csv").open()))
    assert [row["model"].split(":")[0] for row in rows] == ["S", "M", "XL"]
    assert [float(row["paper FID"]) for row in rows] == [0.278, 0.189, 0.116]
    for size in ("parameters", "GFLOPs"):
        values = [float(row[size]) for row in rows]
        assert values == sorted(values), size
    assert all(float(row["FID"]) > 0 for row in rows)
    assert (tmp_path / "page/sizes.png").read_bytes().startswith(b"\x89PNG")

"""The diagnosis makes the runs that it lacks, measures them, and writes a CSV and a plot of each part on one page."""

from __future__ import annotations

import csv

import pytest

from kinema.experiments import launching, pages
from kinema.experiments.pages import load_page
from kinema.experiments.pages.sections import csv_text, markdown, pivot
from kinema.experiments.reproduce import reproduce

pytestmark = pytest.mark.usefixtures("unchecked")

PARTS = ("x_t", "phi", "amplification", "denoising", "directions", "samples", "jitter", "reconstruction")
SMALL = {"motions": 6, "frames": 400, "timesteps": 3}


@pytest.fixture
def small(monkeypatch):
    """Measure a few motions."""
    whole = load_page("diagnosis")
    processes = {"cosine 50": whole["processes"]["cosine 50"]}
    monkeypatch.setattr(pages, "load_page", lambda name: {**whole, **SMALL, "processes": processes})
    return whole


def test_every_part_is_measured_of_every_run(small, micro_tables, tmp_path):
    pytest.importorskip("matplotlib")
    reproduce("diagnosis", [*micro_tables, "generator.train.steps=8"], jobs=1, out=tmp_path / "page")
    page = (tmp_path / "page/README.md").read_text()
    rows = {name: list(csv.DictReader((tmp_path / f"page/{name}.csv").open())) for name in PARTS}
    assert set(PARTS) == small["sections"].keys()
    for name in PARTS:
        assert (tmp_path / f"page/{name}.png").read_bytes().startswith(b"\x89PNG")
        assert f"## {small['sections'][name]['title']}" in page
    generators = {one["label"] for one in small["generators"]}
    for name in ("amplification", "denoising", "directions"):
        assert {row["run"] for row in rows[name]} == generators
    assert {row["run"] for row in rows["jitter"]} == {*generators, "real"}
    assert {row["run"] for row in rows["samples"]} == {*generators, "real halves"}
    assert {row["run"] for row in rows["reconstruction"]} == {one["label"] for one in small["tokenizers"]}
    assert len(rows["phi"]) == 263
    by_prediction = {row["predicts"]: float(row["in clean"]) for row in rows["amplification"]}
    assert by_prediction["x0"] == 1
    assert by_prediction["epsilon"] > 1000
    assert "corpus.name: `synthetic`" in page


def test_rendering_alone_trains_nothing_and_says_what_is_lacking(small, micro_tables, tmp_path, capsys):
    reproduce("diagnosis", [*micro_tables, f"paths.runs={tmp_path}/runs"], render_only=True, out=tmp_path / "page")
    told = capsys.readouterr().out
    assert all(f"no finished run for {one['label']}" in told for one in small["generators"])
    assert not (tmp_path / "runs").exists()
    assert {file.stem for file in (tmp_path / "page").glob("*.csv")} == {"x_t", "phi"}


def test_what_it_trains_goes_to_the_launcher(small, micro_tables, tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(launching, "refuse_absent_slurm", lambda words: None)
    monkeypatch.setattr(launching, "run_multiruns", lambda jobs, words: asked.append((jobs, words)))
    own = [*micro_tables, f"paths.runs={tmp_path}/runs"]
    reproduce("diagnosis", [*own, "launcher=slurm"], out=tmp_path / "page")
    ((jobs, words),) = asked
    assert words == [*own, "launcher=slurm"]
    stages = [job.overrides[0] for job in jobs]
    assert stages.count("stage=generator") == len(small["generators"])
    assert not {word for job in jobs for word in job.overrides} & set(own)  # multiruns give them to every job


def test_tables_of_rows():
    rows = [{"run": "a", "group": "g", "x": 1.23456789}, {"run": "a", "group": "h", "x": float("nan")}]
    assert csv_text(rows) == "run,group,x\na,g,1.23457\na,h,nan\n"
    assert pivot(rows, "group", "x", ("run",))[0]["g"] == 1.23456789
    assert markdown(pivot(rows, "group", "x", ("run",))) == "| run | g | h |\n| --- | --- | --- |\n| a | 1.23 |  |"

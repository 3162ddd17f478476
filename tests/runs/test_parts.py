"""A run's parts are linked by relative paths, and each is loaded as what it is."""

from __future__ import annotations

import shutil

import pytest
import torch

from kinema.generators.length import LengthEstimator
from kinema.runs import weights
from kinema.runs.folder import RunFolder
from kinema.runs.parts import link, load_part, read_text_encoder, upstream, write_text_encoder

SPEC = {"_target_": "kinema.generators.length.LengthEstimator", "text_dim": 4}


@pytest.fixture
def run(tmp_path):
    folder = tmp_path / "runs" / "length"
    weights.save(LengthEstimator(text_dim=4), SPEC, RunFolder(folder).weights, part="length", step=3)
    return folder


def test_links_move_with_the_tree_of_runs(run, tmp_path):
    generator = tmp_path / "runs" / "generator"
    assert upstream(generator) == {}
    link(generator, {"length": run})
    assert upstream(generator) == {"length": run}
    shutil.move(tmp_path / "runs", tmp_path / "elsewhere")
    moved = upstream(tmp_path / "elsewhere" / "generator")["length"]
    assert load_part(moved)[1]["step"] == 3


def test_a_part_is_loaded_as_what_it_is(run):
    for part in (None, "length"):
        module, meta = load_part(run, "cpu", part)
        assert isinstance(module, LengthEstimator)
        assert meta["part"] == "length"
    with pytest.raises(ValueError, match=r"runs/length holds a run of 'length'; give the folder of a 'generator' run"):
        load_part(run, "cpu", "generator")
    weights.save(torch.nn.Linear(1, 1), {"_target_": "kinema.x.Y"}, RunFolder(run).weights)
    with pytest.raises(ValueError, match=r"holds a run of None; give the folder of a 'generator' run"):
        load_part(run, "cpu", "generator")


def test_missing_and_unfinished_runs_are_named(run):
    with pytest.raises(FileNotFoundError, match=r"no run folder at .*none"):
        load_part(run / "none")
    RunFolder(run).weights.unlink()
    with pytest.raises(FileNotFoundError, match=r"has no weights\.safetensors \(its state is 'pending'\)"):
        load_part(run)
    RunFolder(run).mark("running")
    with pytest.raises(FileNotFoundError, match=r"its state is 'running'"):
        load_part(run)


def test_a_run_names_its_text_encoder(run):
    assert read_text_encoder(run) == {}
    write_text_encoder(run, "hashed", None)
    assert read_text_encoder(run) == {"encoder": "hashed", "path": None}

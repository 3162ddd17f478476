"""Run folders and weights come back bit-equal, whole or not at all, and say what is wrong with them."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from torch import nn

from kinema.atomic import write_json
from kinema.pipeline import TextToMotion
from kinema.pipeline.folder import write_parts
from kinema.runs import weights
from kinema.runs.parts import write_text_encoder
from kinema.text.encoders import ENCODERS


def tokenizer_of(parts):
    return parts[0], parts[0].spec


def test_an_artifact_comes_back_bit_equal(parts, tmp_path):
    module, spec = tokenizer_of(parts)
    file = weights.save(module, spec, tmp_path / "deep" / "weights.safetensors", part="tokenizer", step=3)
    state = torch.get_rng_state()
    again, meta = weights.load(file)
    assert torch.equal(torch.get_rng_state(), state)
    assert (meta["part"], meta["step"], meta["spec"]) == ("tokenizer", 3, spec)
    assert again.spec == spec
    assert not again.training
    for key, value in module.state_dict().items():
        assert torch.equal(again.state_dict()[key], value), key
    assert weights.read_meta(file) == meta
    copy = weights.save(again, spec, tmp_path / "copy.safetensors", part="tokenizer", step=3)
    assert copy.read_bytes() == file.read_bytes()


class Tied(nn.Module):
    """Hold one parameter under two names, a view, and a non-contiguous buffer."""

    def __init__(self) -> None:
        super().__init__()
        self.first = nn.Linear(4, 4)
        self.second = nn.Linear(4, 4)
        self.second.weight = self.first.weight
        self.register_buffer("turned", torch.arange(6.0).reshape(2, 3).T)
        self.register_buffer("part", torch.arange(10.0)[2:5])


def test_shared_and_strided_tensors_are_written(tmp_path):
    file = weights.save(Tied(), {"_target_": "kinema.x.Y"}, tmp_path / "weights.safetensors")
    from safetensors.torch import load_file

    state = load_file(file)
    assert torch.equal(state["first.weight"], state["second.weight"])
    assert torch.equal(state["turned"], torch.arange(6.0).reshape(2, 3).T)
    assert file.stat().st_size < 4096


def test_damaged_and_foreign_files_are_named(parts, tmp_path):
    module, spec = tokenizer_of(parts)
    file = weights.save(module, spec, tmp_path / "weights.safetensors")
    whole = file.read_bytes()
    for kept in (0, 5, 100, len(whole) - 1):
        file.write_bytes(whole[:kept])
        for read in (weights.load, weights.read_meta):
            with pytest.raises(ValueError, match=r"weights\.safetensors (cannot be read|is empty)"):
                read(file)
    save_file({"a": torch.zeros(1)}, file)
    with pytest.raises(ValueError, match=r"was not written by kinema.*kinema import"):
        weights.load(file)
    with pytest.raises(FileNotFoundError, match="no weights at"):
        weights.load(tmp_path / "none.safetensors")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width": 8}, "do not fit version"),
        ({"breadth": 8}, "breadth"),
        ({"_target_": "os.system"}, "no class that is marked @buildable"),
        ({"_target_": "kinema.motion.statistics.Statistics"}, "no class that is marked @buildable"),
    ],
)
def test_a_spec_that_does_not_fit_its_weights_is_named(parts, tmp_path, change, message):
    module, spec = tokenizer_of(parts)
    file = weights.save(module, {**spec, **change}, tmp_path / "weights.safetensors")
    with pytest.raises(ValueError, match=message):
        weights.load(file)


def test_a_spec_must_be_plain(parts, tmp_path):
    with pytest.raises(ValueError, match="must be plain"):
        weights.save(parts[0], {"representation": parts[0].representation}, tmp_path / "weights.safetensors")
    assert not list(tmp_path.iterdir())


def test_a_write_that_fails_leaves_the_old_file(parts, tmp_path):
    resource = pytest.importorskip("resource")
    module, spec = tokenizer_of(parts)
    file = weights.save(module, spec, tmp_path / "weights.safetensors")
    before = file.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(before) // 2, limits[1]))
    try:
        with pytest.raises(OSError, match=r"could not write .*weights\.safetensors: .*free disk space"):
            weights.save(module, spec, file)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert file.read_bytes() == before
    assert [f.name for f in tmp_path.iterdir()] == ["weights.safetensors"]


def test_a_run_and_its_portable_copy_generate_the_same(model, run, tmp_path):
    expected = model.generate("a person walks", 22, seed=3)[0].features
    loaded = TextToMotion.from_run(run, "cpu")
    assert np.array_equal(loaded.generate("a person walks", 22, seed=3)[0].features, expected)
    with_length = TextToMotion.from_run(run, "cpu", length=run.parents[1] / "length" / "one")
    portable = with_length.save(tmp_path / "portable")
    shutil.rmtree(run.parents[1])
    shutil.move(portable, tmp_path / "elsewhere")
    again = TextToMotion.from_run(tmp_path / "elsewhere", "cpu")
    assert np.array_equal(again.generate("a person walks", 22, seed=3)[0].features, expected)
    assert np.array_equal(again.generate("x", seed=3)[0].features, model.generate("x", seed=3)[0].features)


def test_saving_never_overwrites_and_leaves_no_half(model, tmp_path, monkeypatch):
    (tmp_path / "taken").mkdir()
    with pytest.raises(ValueError, match="taken exists; choose another"):
        model.save(tmp_path / "taken")
    monkeypatch.delattr(model.tokenizer, "spec")
    with pytest.raises(ValueError, match="AutoEncoder has no spec"):
        model.save(tmp_path / "new")
    assert [f.name for f in tmp_path.iterdir()] == ["taken"]


def test_unfit_run_folders_are_named(run):
    def fails(error, message, folder=run):
        with pytest.raises(error, match=message):
            TextToMotion.from_run(folder, "cpu")

    fails(FileNotFoundError, "no run folder at", run / "none")
    fails(
        ValueError,
        "holds a run of 'tokenizer'; give the folder of a 'generator' run",
        run.parents[1] / "tokenizer" / "one",
    )
    write_json(run / "text.json", {"encoder": "nothing"})
    fails(ValueError, "unknown text encoder 'nothing'")
    (run / "text.json").unlink()
    fails(ValueError, r"text\.json names no encoder")
    (run / "upstream.json").write_text("{")
    fails(ValueError, r"upstream\.json is damaged")
    write_json(run / "upstream.json", {"tokenizer": "../../tokenizer/gone"})
    write_json(run / "text.json", {"encoder": "hashed"})
    fails(FileNotFoundError, "no run folder at .*gone")
    (run / "weights.safetensors").unlink()
    write_json(run / "status.json", {"state": "running"})
    fails(FileNotFoundError, r"has no weights\.safetensors \(its state is 'running'\)")


def test_another_text_encoder_than_in_training_is_refused(parts, run):
    generator = parts[1]
    weights.save(generator, generator.spec, run / "weights.safetensors", part="generator", text="clip_b32-abc")
    with pytest.raises(ValueError, match="was trained with the text encoder clip_b32-abc, this one is hashed-64"):
        TextToMotion.from_run(run, "cpu")
    assert json.loads((run / "text.json").read_text())["encoder"] == "hashed"


@pytest.mark.parametrize("path", ["someone/else", "/nowhere/clip", "../clip", "https://host/clip", "openai/clip-vit-x"])
def test_a_text_encoder_outside_of_the_run_is_not_asked_for_by_a_file(run, path, monkeypatch):
    monkeypatch.setattr("huggingface_hub.snapshot_download", lambda *_, **__: pytest.fail("the network was asked for"))
    write_json(run / "text.json", {"encoder": "clip_b32", "path": path})
    with pytest.raises(ValueError, match=r"text\.json takes its text encoder from .*, which lies outside"):
        TextToMotion.from_run(run, "cpu")


@pytest.mark.parametrize(
    ("name", "variable"), [("clip_b32", "CLIP_B32"), ("distilbert", "DISTILBERT"), ("t5_small", "T5_SMALL")]
)
def test_a_published_text_encoder_is_looked_for_where_this_machine_has_it(name, variable, run, tmp_path, monkeypatch):
    monkeypatch.setenv(variable, str(tmp_path / "mine"))
    write_json(run / "text.json", {"encoder": name, "path": ENCODERS[name].published})
    with pytest.raises(FileNotFoundError, match=f"no .* model at '{tmp_path / 'mine'}'"):
        TextToMotion.from_run(run, "cpu")


def test_a_saved_model_names_no_folder_of_this_machine(parts, tmp_path):
    tokenizer, generator, *_ = parts
    write_parts(
        tmp_path / "saved", generator, {"tokenizer": tokenizer}, {"encoder": "t5_small", "path": "/mine/t5"}, {}
    )
    assert json.loads((tmp_path / "saved/text.json").read_text())["path"] == "google-t5/t5-small"


def test_a_text_encoder_that_training_was_given_is_read(run, tmp_path):
    write_text_encoder(run, "clip_b32", str(tmp_path / "clip"))
    with pytest.raises(FileNotFoundError, match=r"no CLIP model at .*clip"):
        TextToMotion.from_run(run, "cpu")


@pytest.mark.parametrize("path", ["../clip", "{outside}"])
def test_a_folder_outside_that_is_there_is_not_read(run, tmp_path, path):
    (run.parent / "clip").mkdir()
    write_json(run / "text.json", {"encoder": "clip_b32", "path": path.format(outside=run.parent / "clip")})
    with pytest.raises(ValueError, match=r"text\.json takes its text encoder from .*, which lies outside"):
        TextToMotion.from_run(run, "cpu")


def test_only_a_model_is_replaced(model, tmp_path):
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "one").touch()
    with pytest.raises(ValueError, match="photos exists"):
        model.save(tmp_path / "photos", replace=True)
    assert [p.name for p in (tmp_path / "photos").iterdir()] == ["one"]

"""A packed model is its run in one folder, says what it is and knows, and is found by its name."""

from __future__ import annotations

import json
import os
import warnings
from dataclasses import replace

import numpy as np
import pytest
import torch
import yaml

from kinema import cli
from kinema.atomic import write_json
from kinema.files.checkpoints import read_safetensors
from kinema.pipeline import TextToMotion, models
from kinema.pipeline.card import Card
from kinema.pipeline.models import DEFAULT, Found, find_model
from kinema.pipeline.repertoire import Repertoire, threshold_between, unit
from kinema.runs import weights
from kinema.text.encoders import build_text_encoder

KNOWN = ["a person walks forward", "a person jumps high", "someone waves with both hands"]
CARD = Card(
    name="walker",
    method="MARDM-SiT",
    corpus="a corpus (0.1 hours)",
    motion="22 joints",
    text_encoder="hashed-64",
    parameters={"generator": 10, "tokenizer": 1200},
    citation="Somebody et al., {braces}",
    licence="CC BY-NC 4.0",
    half=True,
    sources=[{"source": "studio", "licence": "CC BY-NC 4.0", "clips": 3}],
    commands=["kinema train stage=generator"],
    figures=[{"split": "val", "scores": {"FID": "0.9 ± 0.1"}, "command": "kinema evaluate source=generation"}],
    versions={"torch": "2.13.0"},
)


@pytest.fixture
def repertoire() -> Repertoire:
    rows = unit(build_text_encoder("hashed")(KNOWN).pooled)
    return Repertoire(rows, ["walk", "jump", "wave"], {"walk": 3, "jump": 2, "wave": 1}, {"normal": 6}, 0.9)


@pytest.fixture
def packed(model, repertoire, tmp_path):
    model.card, model.repertoire = CARD, repertoire
    return model.save(tmp_path / "walker", half=True)


def test_half_the_precision_is_half_the_size_and_nearly_the_motion(model, run, packed):
    whole = weights.read_meta(run / "weights.safetensors")
    assert weights.read_meta(packed / "weights.safetensors")["spec"] == whole["spec"]
    sizes = [(folder / "weights.safetensors").stat().st_size for folder in (run, packed)]
    assert sizes[1] < 0.55 * sizes[0] + 4096
    again = TextToMotion.from_pretrained(packed, "cpu")
    for name, tensor in again.generator.named_parameters():
        assert torch.equal(tensor, model.generator.get_parameter(name).half().float()), name
    for name, tensor in again.tokenizer.named_buffers():  # mean and deviation of the features
        assert torch.equal(tensor, model.tokenizer.get_buffer(name)), name
    first, second = (one.generate(KNOWN, 40, seed=3) for one in (model, again))
    apart = [np.linalg.norm(a.joints - b.joints, axis=-1).max() for a, b in zip(first, second, strict=True)]
    assert 0 < max(apart) < 0.02
    assert again.save(packed.parent / "twice", half=True)
    files = [(folder / "weights.safetensors").read_bytes() for folder in (packed, packed.parent / "twice")]
    assert files[0] == files[1]


def test_a_weight_that_half_precision_cannot_hold_is_named(tmp_path):
    module = torch.nn.Linear(2, 2)
    with torch.no_grad():
        module.weight[0, 0] = 1e6
    with pytest.raises(ValueError, match="half precision can't hold 'weight', of up to 1e"):
        weights.save(module, {"_target_": "kinema.x.Y"}, tmp_path / "weights.safetensors", half=True)
    assert not list(tmp_path.iterdir())


def test_a_card_comes_back_and_heads_its_page_as_the_hub_reads_it(packed):
    assert Card.read(packed) == CARD
    _, head, text = (packed / "README.md").read_text().split("---\n", 2)
    assert yaml.safe_load(head)["license"] == "cc-by-nc-4.0"
    for said in ("studio | CC BY-NC 4.0 | 3", "{braces}", "FID | 0.9 ± 0.1", "kinema train stage=generator", "1,200"):
        assert said in text
    replace(CARD, licence="that of the corpus").write(packed)
    assert yaml.safe_load((packed / "README.md").read_text().split("---\n")[1])["license"] == "other"


def test_a_repertoire_comes_back(packed, repertoire):
    again = Repertoire.read(packed)
    assert (again.owners, again.clips, again.styles) == (repertoire.owners, repertoire.clips, repertoire.styles)
    cosines = torch.nn.functional.cosine_similarity(again.directions, repertoire.directions)
    assert cosines.min() > np.cos(np.deg2rad(1))
    assert read_safetensors(packed / "repertoire.safetensors")[0]["directions"].dtype == torch.int8


def test_texts_far_from_all_that_is_known_are_told_and_made(packed):
    model = TextToMotion.from_pretrained(packed, "cpu")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model.generate(KNOWN, 8, seed=0)
    strange = "quantum computers factor large numbers"
    with pytest.warns(UserWarning, match=rf"'{strange}' is far from all .* the nearest it knows: \w+; \w+; \w+ \("):
        assert len(model.generate([KNOWN[0], strange, strange], 8, seed=0)) == 3
    with pytest.warns(UserWarning, match="' and 1 more texts are far"):
        model.generate([strange, "tomato soup"], 8, seed=0)
    with pytest.warns(UserWarning, match="is far from all"):
        model.edit(model.generate(KNOWN[0], 16, seed=0), strange, "prefix", seed=1)


def test_a_threshold_stands_at_the_foreign_end_of_the_gap():
    own, foreign = torch.linspace(0.8, 1, 101), torch.linspace(0, 0.5, 101)
    assert threshold_between(own, foreign) == pytest.approx(0.485)
    assert threshold_between(foreign, own) == pytest.approx(0.005)  # no gap: of its own 1 %


@pytest.mark.parametrize("rows", [{"sources": [{"source": "x"}]}, {"figures": [3]}, {"commands": [None]}])
def test_a_card_of_other_rows_is_named(packed, rows):
    write_json(packed / "card.json", json.loads((packed / "card.json").read_text()) | rows)
    with pytest.raises(ValueError, match=rf"card\.json has '{next(iter(rows))}': a row (has|holds)"):
        Card.read(packed)


def test_a_downloaded_repertoire_does_not_steer_a_terminal(packed, repertoire):
    replace(repertoire, owners=["\x1b[2Jwalk", "jump", "wave"]).write(packed)
    with pytest.warns(UserWarning, match="is far from all") as told:
        TextToMotion.from_pretrained(packed, "cpu").encode(["quantum computers"])
    assert "\x1b" not in str(told[0].message)


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("card.json", b"{", "card.json is damaged"),
        ("card.json", b'{"name": 3}', r"card.json has 'name': it holds a number|card.json has 'name'"),
        ("repertoire.safetensors", b"nothing", r"repertoire\.safetensors"),
        ("upstream.json", b'{"tokenizer": "../../elsewhere"}', "takes its tokenizer from .* which lies outside"),
        ("tokenizer/weights.safetensors", b"nothing", r"weights\.safetensors"),
    ],
)
def test_a_packed_model_is_held_to_what_runs_are_held_to(packed, file, content, message):
    (packed / file).write_bytes(content)
    with pytest.raises(ValueError, match=message):
        TextToMotion.from_pretrained(packed, "cpu")


def test_a_link_to_the_outside_is_not_followed(packed, tmp_path):
    os.rename(packed / "tokenizer", tmp_path / "elsewhere")
    (packed / "tokenizer").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(ValueError, match="which lies outside"):
        TextToMotion.from_pretrained(packed, "cpu")


def test_a_repertoire_of_another_text_encoder_is_refused(packed, repertoire):
    replace(repertoire, directions=torch.ones(3, 5)).write(packed)
    with pytest.raises(ValueError, match="knows texts of 5 numbers, hashed-64"):
        TextToMotion.from_pretrained(packed, "cpu")


def test_models_are_found_by_name_folder_and_nothing_else(packed, tmp_path, monkeypatch):
    monkeypatch.setattr("huggingface_hub.snapshot_download", lambda *_, **__: pytest.fail("the network was asked for"))
    monkeypatch.setattr(models, "SHIPPED", tmp_path)
    monkeypatch.chdir(packed)
    assert find_model("walker") == packed
    assert find_model(packed) == packed
    assert find_model("tokenizer/gone") == type(packed)("tokenizer/gone")  # a path beside what is there
    with pytest.raises(FileNotFoundError, match=f"came without the model {DEFAULT}; give --run"):
        find_model(DEFAULT)
    with pytest.raises(FileNotFoundError, match="no run folder at nothing"):
        TextToMotion.from_pretrained("nothing")


def test_a_model_without_a_card_is_not_published(model):
    with pytest.raises(ValueError, match="has no card to publish it with: `kinema pack RUN"):
        model.push_to_hub("somebody/walker")


def test_a_repertoire_of_nothing_is_refused(packed, repertoire):
    replace(repertoire, owners=[], directions=repertoire.directions[:1]).write(packed)
    with pytest.raises(ValueError, match="directions"):
        TextToMotion.from_run(packed)


def test_a_damaged_card_in_the_cache_hides_no_other_model(packed, tmp_path, monkeypatch, capsys):
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "card.json").write_text('{"title": "x"}')
    cached = [Found("a/b", tmp_path / "other"), Found("c/d", packed)]
    monkeypatch.setattr("kinema.cli.models.cached", lambda: cached)
    assert cli.main(["models"]) == 0
    said = capsys.readouterr()
    assert "c/d" in said.out
    assert "a/b is left out" in said.err


def test_a_model_that_is_nowhere_is_said_to_be(capsys):
    assert cli.main(["models", "nope"]) == 2
    assert "nope is no model at hand; `kinema models` lists" in capsys.readouterr().err


def test_a_card_writes_no_lines_of_its_own(packed, capsys):
    card = json.loads((packed / "card.json").read_text())
    (packed / "card.json").write_text(json.dumps(card | {"citation": "A.\nlicence   MIT"}))
    assert cli.main(["models", str(packed)]) == 0
    assert [line for line in capsys.readouterr().out.splitlines() if line.startswith("licence")] == [
        f"licence   {CARD.licence}"
    ]

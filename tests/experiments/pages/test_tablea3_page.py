"""The page of inference time: every method is timed untrained, part by part, and what is counted is right."""

from __future__ import annotations

import csv

import pytest
import torch

from kinema.data.store import PackedStore
from kinema.evaluation.latency import PARTS, Latency, measure_latency
from kinema.experiments import pages
from kinema.experiments.config import CONF, compose
from kinema.experiments.corpus import open_corpus
from kinema.experiments.pages import load_page
from kinema.experiments.pages.subjects import read_motions
from kinema.experiments.pages.tablea3 import summary
from kinema.experiments.pages.untrained import untrained
from kinema.experiments.reproduce import reproduce
from kinema.text.hashed import HashedTextEncoder

pytestmark = pytest.mark.usefixtures("unchecked")

ALONE = {"mdm_epsilon", "mardm_frames", "mardm_parallel"}
"""Ablations: as fast as what they are of."""


def test_every_method_has_a_row():
    named = {spec["method"] for spec in load_page("tablea3")["methods"]}
    assert named == {file.stem for file in (CONF / "method").glob("*.yaml")} - ALONE


def test_methods_are_timed_without_training_and_written(micro, tmp_path, monkeypatch, capsys):
    pytest.importorskip("matplotlib")
    small = load_page("tablea3") | {"motions": 5, "batches": [1, 2, 64], "warmup": 1, "at": {}}
    small["methods"] = [spec for spec in small["methods"] if spec["key"] in ("mardm_sit", "momask", "t2m_gpt")]
    monkeypatch.setattr(pages, "load_page", lambda name: small)
    reproduce("tablea3", micro, jobs=1, out=tmp_path / "page")
    told = capsys.readouterr().out
    assert "train " not in told
    assert "no batch of 64: the test split has 5 motions" in told
    rows = list(csv.DictReader((tmp_path / "page/times.csv").open()))
    counts = [(batch, motions) for _ in range(3) for batch, motions in (("1", "5"), ("2", "4"))]
    assert [(row["batch"], row["motions"]) for row in rows] == counts
    assert list(dict.fromkeys(row["key"] for row in rows)) == ["t2m_gpt", "momask", "mardm_sit"]
    for row in rows:
        parts = [float(row[f"{part} (s)"]) for part in PARTS]
        assert all(part > 0 for part in parts)
        assert float(row["s / motion"]) == pytest.approx(sum(parts), rel=1e-4)
    assert [row["paper (s)"] for row in rows[:2]] == ["0.32", ""]  # the paper's are of single motions
    page = (tmp_path / "page/README.md").read_text()
    assert "weights: `as training begins`" in page
    assert (tmp_path / "page/times.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ValueError, match="leave --render-only out"):
        reproduce("tablea3", micro, render_only=True)


def test_warm_up_is_not_counted_and_calls_are_those_of_one_batch(micro_tables):
    cfg = compose([*micro_tables, "method=mdm"], "evaluate")
    store = PackedStore.open(open_corpus(cfg))
    asked = read_motions(store, "test", 4)
    model = untrained(cfg, store, asked)
    steps = model.generator.sampling.solver_steps
    for warmup in (0, 2):
        timed = measure_latency(model, asked.texts, asked.lengths.tolist(), batch=2, warmup=warmup)
        assert [latency.motions for latency in timed] == [2, 2]
        assert [latency.calls for latency in timed] == [{"denoiser": steps}] * 2
    with pytest.raises(ValueError, match="4 texts do not fill a batch of 5"):
        measure_latency(model, asked.texts, asked.lengths.tolist(), batch=5)


def test_texts_are_encoded_anew_in_every_batch_and_not_looked_up(micro_tables, monkeypatch):
    cfg = compose([*micro_tables, "method=mdm"], "evaluate")
    store = PackedStore.open(open_corpus(cfg))
    asked = read_motions(store, "test", 4)
    model, encoded = untrained(cfg, store, asked), []
    encode = HashedTextEncoder.__call__
    monkeypatch.setattr(
        HashedTextEncoder, "__call__", lambda own, texts: encoded.append(list(texts)) or encode(own, texts)
    )
    for _ in range(2):
        measure_latency(model, asked.texts, asked.lengths.tolist(), batch=2, warmup=0)
    assert encoded == [asked.texts[:2], asked.texts[2:]] * 2


def test_latents_and_their_decoding_are_a_sample(micro):
    cfg = compose([*micro, "method=mardm_sit"], "evaluate")
    store = PackedStore.open(open_corpus(cfg))
    asked = read_motions(store, "test", 3)
    model = untrained(cfg, store, asked).eval()
    text, seeds = model.text_encoder(asked.texts), torch.arange(3)
    with torch.no_grad():
        whole = model.sample(text, asked.lengths, seeds=seeds)
        parts = model.tokenizer.decode(model.sample_latents(text, asked.lengths, seeds=seeds))
    assert torch.equal(whole.features, parts.features)
    assert torch.equal(whole.lengths, asked.lengths)


def test_means_are_over_motions():
    timed = [Latency(2, {"text": 1.0, "generation": 2.0, "decoding": 1.0}, {}) for _ in range(2)]
    means = {"s / motion": 2.0, "text (s)": 0.5, "generation (s)": 1.0, "decoding (s)": 0.5}
    assert summary(timed) == {**means, "network calls": None, "motions": 4}

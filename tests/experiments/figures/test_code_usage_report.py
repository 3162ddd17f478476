"""The report on code usage counts what trained tokenizers make of a split, and shows both representations."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch

from kinema.data.store import PackedStore
from kinema.experiments.config import compose
from kinema.experiments.corpus import open_corpus
from kinema.experiments.figures import code_usage
from kinema.experiments.instantiate import read_model
from kinema.experiments.run import run_stage
from kinema.runs.console import console
from kinema.types import MotionBatch


@pytest.fixture
def runs(micro):
    """Give the finished micro runs of one tokenizer, essential and redundant."""
    return {
        kind: run_stage(compose([*micro, "method=t2m_gpt", f"representation={kind}"]), "tokenizer").path
        for kind in ("essential", "redundant")
    }


def result(tokenizer="vq", dims="redundant", histograms=((6, 3, 1, 0),), **other) -> dict:
    layers = [
        {"perplexity": 2.5, "used": sum(n > 0 for n in row), "dead": row.count(0), "histogram": list(row)}
        for row in histograms
    ]
    means = {name: float(np.mean([layer[name] for layer in layers])) for name in ("perplexity", "used", "dead")}
    corpus = {"name": "synthetic", "hash": "abc", "split": "test"}
    base = {"run": f"runs/{dims}", "tokenizer": tokenizer, "dims": dims, "seed": 0, "scale": "smoke"}
    return base | {"corpus": corpus, "codebook_size": 4, "codes": 10, **means, "layers": layers} | other


def test_the_codes_of_a_split_are_counted(micro, runs, tmp_path):
    with console.capture() as said:
        code_usage.main([*map(str, runs.values()), "--split", "val", "--out", str(tmp_path), "--accelerator", "cpu"])
    assert [line.split("/")[-1] for line in said.get().splitlines()][:2] == ["code_usage.json", "code_usage.md"]
    found = json.loads((tmp_path / "code_usage.json").read_text())["runs"]
    assert [r["dims"] for r in found] == ["redundant", "essential"]
    tokenizer = read_model(runs["essential"])
    store = PackedStore.open(open_corpus(compose([*micro, "method=t2m_gpt"])))
    counts = torch.zeros(tokenizer.space.codebook_size, dtype=torch.long)
    for clip in store.split_clips("val"):
        rows = torch.from_numpy(store.clip_frames(clip).copy())[None]
        codes = tokenizer.encode(MotionBatch(rows, torch.tensor([rows.shape[1]]))).codes
        counts += torch.bincount(codes.flatten(), minlength=len(counts))
    assert found[1]["layers"][0]["histogram"] == counts.sort(descending=True).values.tolist()
    assert found[1]["codes"] == counts.sum()
    assert found[1]["used"] + found[1]["dead"] == tokenizer.space.codebook_size
    assert found[1]["used"] == (counts > 0).sum()


def test_the_table_has_a_row_per_layer_and_their_mean():
    text = code_usage.markdown([result(), result("rvq", "essential", ((5, 5, 0, 0), (4, 3, 2, 1)))])
    rows = [line for line in text.splitlines() if line.startswith("| ")][1:]
    assert rows == [
        "| vq (smoke, seed 0) | redundant | 1 | 4 | 3 | 1 | 2.5 |",
        "| rvq (smoke, seed 0) | essential | 1 | 4 | 2 | 2 | 2.5 |",
        "| rvq (smoke, seed 0) | essential | 2 | 4 | 4 | 0 | 2.5 |",
        "| rvq (smoke, seed 0) | essential | mean | 4 | 3.0 | 1.0 | 2.5 |",
    ]
    assert "synthetic (abc), split test" in text


def test_the_figure_puts_redundant_beside_essential(tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    seen = []
    monkeypatch.setattr(code_usage, "_histogram", lambda panel, r: seen.append((panel.get_title(), r["tokenizer"])))
    results = [result(), result("rvq", "essential"), result("vq", "essential")]
    assert code_usage.draw(results, tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    titles = ["vq (smoke, seed 0), redundant", "vq (smoke, seed 0), essential", "rvq (smoke, seed 0), essential"]
    assert sorted(seen) == sorted(zip(titles, ("vq", "vq", "rvq"), strict=True))


def test_without_matplotlib_the_numbers_are_written(tmp_path, monkeypatch):
    def absent(*_, **__):
        raise ImportError("drawing needs matplotlib: pip install 'kinema[viz]'")

    monkeypatch.setattr(code_usage, "new_figure", absent)
    with console.capture() as said:
        written = code_usage.write_report([result()], tmp_path)
    assert [path.name for path in written] == ["code_usage.json", "code_usage.md"]
    assert "no figure: drawing needs matplotlib: pip install 'kinema[viz]'" in said.get()
    assert not list(tmp_path.glob("*.png"))


def test_what_holds_no_codes_is_named(micro, tmp_path):
    with pytest.raises(SystemExit, match=r"is no finished run of a tokenizer \(its state is 'pending'\)"):
        code_usage.main([str(tmp_path)])
    run = run_stage(compose(micro), "tokenizer").path
    with pytest.raises(SystemExit, match="holds AutoEncoder, which has no codes"):
        code_usage.main([str(run)])

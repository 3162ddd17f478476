"""One replication: right numbers for known sources, repeatable, cached, and clear when it fails."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
import torch

from kinema.evaluation.cache import motion_key, text_key
from kinema.evaluation.metrics import FrechetDistance, Retrieval
from kinema.evaluation.metrics.neighbours import isolation
from kinema.evaluation.protocol import EmbeddingCache, EvaluationProtocol, evaluate_replication
from kinema.evaluation.source import Source, answer
from kinema.evaluation.sources import RealMotion, ShuffledCaptions
from kinema.evaluation.training_set import TrainingSet
from kinema.seeds import protocol_seeds
from kinema.types import Caption

SMALL = EvaluationProtocol(pool=8, mm_texts=12, mm_repeats=5, mm_pairs=2, diversity_pairs=20)


class Noisy(Source):
    """Answer with the real motion plus noise by seed; counts its calls."""

    label, multimodal, reconstructs = "noisy", True, True

    def __init__(self, scale=0.05):
        self.scale, self.calls = scale, 0

    def __call__(self, batch, seeds):
        self.calls += len(seeds)
        rows = []
        for row, seed in zip(batch.features, seeds.tolist(), strict=True):
            noise = torch.randn(len(row), 67, generator=torch.Generator().manual_seed(seed))
            rows.append(row[:, :67] + self.scale * noise)
        return answer(batch, torch.stack(rows) * batch.mask[..., None], batch.lengths)


def batches(make, count=4, size=8):
    return [make.batch(size=size, seed=seed) for seed in range(count)]


def run(make, source, protocol=SMALL, work=None, **options):
    work = batches(make) if work is None else work
    return evaluate_replication(source, work, make.matching(), make.contrastive(), protocol, **options)


def test_every_metric_has_its_key(make):
    found = run(make, Noisy()).metrics
    measured = {"foot_skating", "jitter", "float_mm", "penetration_mm"}
    physical = {*measured, *(f"real_{name}" for name in measured), "turn_ratio", "root_speed_ratio"}
    text = {"r1", "r2", "r3", "matching", "fid", "diversity", "multimodality", "clip_score"}
    paired = {"mpjpe_mm", "mpjpe_heading_mm", "heading_error_deg"}
    spread = {"fid_halves", "real_fid_halves", "fid_l2", "precision", "recall", "density", "coverage"}
    shares = {f"r{k}_of_real" for k in (1, 2, 3)}
    assert set(found) == physical | text | paired | spread | shares | {"n"}
    assert found["n"] == 32
    assert all(np.isfinite(v) for v in found.values())
    real = run(make, RealMotion()).metrics
    assert set(real) == set(found) - paired - {"multimodality"}
    assert real["fid"] < 1e-6
    assert real["fid_l2"] < 1e-6
    assert all(real[name] == 1 for name in ("r1_of_real", "precision", "recall", "density", "coverage"))
    assert real["fid_halves"] == real["real_fid_halves"] == found["real_fid_halves"] != found["fid_halves"]
    assert real["root_speed_ratio"] == real["turn_ratio"] == 1
    assert real["jitter"] == real["real_jitter"]


def test_numbers_are_those_of_the_metrics_on_plain_embeddings(make):
    source, model = Noisy(), make.matching().eval()
    retrieval, fid, first = Retrieval(8), FrechetDistance(8), 0
    for real in batches(make):
        made = source(real, protocol_seeds(0, 3, first, 8))
        retrieval.update(model.embed_text(real.captions), model.embed_motion(made))
        fid.update(model.embed_motion(real), model.embed_motion(made))
        first += 8
    expected = retrieval.compute() | {"fid": fid.compute()}
    found = run(make, Noisy(), replication=3).metrics
    for name, value in expected.items():
        assert found[name] == pytest.approx(value.item(), rel=1e-5)


def test_shuffled_captions_keep_the_fid_and_lose_the_text(make):
    work = [make.batch(size=32, seed=seed) for seed in range(30)]
    codes = {c.text: f for b in work for c, f in zip(b.captions, b.features[:, 0, :8], strict=True)}
    protocol, blind, knowing = replace(SMALL, pool=32), make.matching(), make.matching()
    knowing.embed_motion = lambda batch: batch.features[:, 0, :8]
    knowing.embed_text = lambda captions: torch.stack([codes[c.text] for c in captions])
    assert evaluate_replication(RealMotion(), work, knowing, protocol=protocol).metrics["r1"] == 1
    for model, hits in ((blind, (1, 2, 3)), (knowing, (0, 1, 2))):
        found = evaluate_replication(ShuffledCaptions(), work, model, protocol=protocol).metrics
        assert found["fid"] < 1e-6
        for k, count in enumerate(hits, start=1):
            # An untrained judge hits by chance; one that knows every clip ranks the right one before the given one.
            assert abs(found[f"r{k}"] - count / 32) < 3 * (count / 32 / (30 * 32)) ** 0.5 + 0.002


def test_multimodality_leaves_the_other_metrics_alone(make):
    source, without = Noisy(), Noisy()
    full = run(make, source).metrics
    short = run(make, without, replace(SMALL, mm_texts=0)).metrics
    assert {k: v for k, v in full.items() if k != "multimodality"} == short
    # 12 captions are answered 5 times, the others once.
    assert (source.calls, without.calls) == (32 + 12 * 4, 32)
    wider = run(make, Noisy(0.2)).metrics
    assert wider["multimodality"] > 1.5 * full["multimodality"]


def test_replications_differ_and_repeat_exactly(make):
    one, again, other = (run(make, Noisy(), replication=r).metrics for r in (0, 0, 1))
    assert one == again
    assert one["mpjpe_mm"] != other["mpjpe_mm"]
    seeds = torch.cat([protocol_seeds(0, r, first, 8, k) for r in (0, 1) for first in (0, 8) for k in (0, 1)])
    assert len(set(seeds.tolist())) == 64
    assert torch.equal(protocol_seeds(0, 1, 4, 2), protocol_seeds(0, 1, 0, 6)[4:])


@pytest.mark.parametrize(("leftover", "counted", "rows"), [("drop", 16, 16), ("keep", 19, 19), ("mld", 16, 19)])
def test_leftover_rows(make, leftover, counted, rows):
    work = [make.batch(seed=0), make.batch(seed=1), make.batch(size=3, seed=2)]
    found = run(make, RealMotion(), replace(SMALL, leftover=leftover), work)
    assert found.metrics["n"] == rows
    hits = found.metrics["r1"] * counted
    assert hits == pytest.approx(round(hits), abs=1e-4)
    with pytest.raises(ValueError, match="no batch holds a whole pool of 8"):
        run(make, RealMotion(), SMALL, work[2:])


def test_breakdowns_partition_the_rows(make):
    def fields(batch):
        return {"source": ["a" if i % 4 == 0 else "b" for i in batch.entries.tolist()]}

    found = run(make, Noisy(), fields=fields)
    parts = found.breakdowns["source"]
    assert {k: v["n"] for k, v in parts.items()} == {"a": 8, "b": 24}
    for name in ("r1", "r3", "matching", "clip_score", "foot_skating"):
        mean = sum(p[name] * p["n"] for p in parts.values()) / 32
        assert mean == pytest.approx(found.metrics[name], rel=1e-5)
    assert parts["a"]["fid"] != parts["b"]["fid"]
    assert "coverage" not in parts["a"]  # of the whole alone


def test_training_motion_is_known_again_and_nothing_is_embedded_for_it(make):
    model, work = make.matching(), batches(make)
    count = Counting(model)
    with torch.no_grad():
        known = torch.cat([model.embed_motion(batch) for batch in work])
    training = TrainingSet(known, isolation(known, torch.tensor([[i, 0, 9] for i in range(len(known))])))
    count.motions = 0
    plain = evaluate_replication(Noisy(), work, model, protocol=SMALL).metrics
    embedded, count.motions = count.motions, 0
    found = evaluate_replication(Noisy(), work, model, protocol=SMALL, training=training).metrics
    assert count.motions == embedded
    assert found.keys() - plain.keys() == {"nearest_train", "memorised"}
    assert all(found[key] == value for key, value in plain.items())
    assert found["nearest_train"] > 0
    real = evaluate_replication(RealMotion(), work, model, protocol=SMALL, training=training).metrics
    assert real["nearest_train"] < 1e-5
    assert real["memorised"] == 1


def test_samples_show_the_first_answers(make):
    found = run(make, Noisy(), watch=3)
    assert found.samples.texts == found.references.texts == batches(make)[0].texts[:3]
    assert found.samples.features.shape[-1] == 67
    assert not torch.equal(found.samples.features, found.references.features[..., :67])


class Counting:
    """Count what a model embeds."""

    def __init__(self, model):
        self.model, self.motions, self.texts = model, 0, 0
        self.embed_motion, self.embed_text = model.embed_motion, model.embed_text
        model.embed_motion, model.embed_text = self.count_motion, self.count_text

    def count_motion(self, batch):
        self.motions += len(batch.lengths)
        return self.embed_motion(batch)

    def count_text(self, captions):
        self.texts += len(captions)
        return self.embed_text(captions)


def test_real_motion_and_captions_are_embedded_once_for_all_sources(make, tmp_path, capsys):
    cache, model = EmbeddingCache(tmp_path, corpus="c0"), make.matching()
    count = Counting(model)
    work = batches(make)
    first = evaluate_replication(Noisy(), work, model, protocol=SMALL, cache=cache).metrics
    assert (count.motions, count.texts) == (32 + 32 + 48, 32)
    again = evaluate_replication(Noisy(), work, model, protocol=SMALL, cache=cache).metrics
    assert again == first
    assert (count.motions, count.texts) == (112 + 80, 32)
    evaluate_replication(RealMotion(), work, model, protocol=SMALL, cache=cache)
    assert (count.motions, count.texts) == (192, 32)
    # Other crops of the same corpus under the same name are computed, not served.
    moved = [replace(b, features=b.features * 1.01) for b in work]
    evaluate_replication(RealMotion(), moved, model, protocol=SMALL, cache=cache)
    assert (count.motions, count.texts) == (224, 32)
    with torch.no_grad():
        model.motion_encoder.hidden.add_(1)
    evaluate_replication(RealMotion(), work, model, protocol=SMALL, cache=cache)
    assert (count.motions, count.texts) == (256, 64)
    files = sorted(p for p in tmp_path.rglob("*") if p.is_file())
    assert [p.name for p in files] == ["c0-s0-r000.npz"] * 2
    for path in files:
        path.write_bytes(path.read_bytes()[:100])
    capsys.readouterr()
    evaluate_replication(RealMotion(), work, model, protocol=SMALL, cache=cache)  # a cache is made again
    assert (count.motions, count.texts) == (288, 96)
    assert re.search(r"c0-s0-r000\.npz is a damaged archive", capsys.readouterr().out)


@pytest.mark.parametrize("where", ["real", "generated"])
def test_a_clip_that_is_not_finite_is_named(make, where):
    work = batches(make)

    class Broken(Noisy):
        def __call__(self, batch, seeds):
            found = super().__call__(batch, seeds)
            if "clip1-005" in batch.clip_ids:
                found.features[batch.clip_ids.index("clip1-005"), 0, 9] = float("nan")
            return found

    if where == "real":
        work[1].features[5, 0, 9] = float("inf")
    with pytest.raises(ValueError, match="clip1-005 hold NaN or infinity"):
        run(make, Broken() if where == "generated" else RealMotion(), work=work)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"leftover": "pad"}, "EvaluationProtocol.leftover=pad: must be one of drop, keep, mld"),
        ({"pool": 1}, "EvaluationProtocol.pool=1: must be a whole number from 2"),
        ({"mm_repeats": 1}, r"mm_repeats=1; MultiModality compares at least 2"),
        ({"max_batches": 0}, r"max_batches=0"),
    ],
)
def test_a_protocol_that_cannot_be_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        EvaluationProtocol(**change)


def test_a_short_protocol_stops_early(make):
    assert run(make, RealMotion(), replace(SMALL, max_batches=2)).metrics["n"] == 16


def test_keys_tell_lengths_and_tokens_apart(make):
    batch = make.batch(lengths=[40] * 8)
    assert motion_key(batch) != motion_key(replace(batch, lengths=batch.lengths - 4))
    assert text_key([Caption("a", ("a/DET",))]) != text_key([Caption("a", ("a/NOUN",))])


def test_parts_have_the_fid_of_their_own_rows(make):
    model = make.matching().eval()
    found = evaluate_replication(
        Noisy(0.3),
        batches(make),
        model,
        protocol=SMALL,
        fields=lambda b: {"source": ["a" if i % 4 == 0 else "b" for i in b.entries.tolist()]},
    )
    fid = FrechetDistance(8)
    for i, real in enumerate(batches(make)):
        made = Noisy(0.3)(real, protocol_seeds(0, 0, 8 * i, 8))
        keep = real.entries % 4 == 0
        fid.update(model.embed_motion(real)[keep], model.embed_motion(made)[keep])
    assert found.breakdowns["source"]["a"]["fid"] == pytest.approx(fid.compute().item(), rel=1e-4)

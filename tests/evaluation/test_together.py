"""Batches that are answered at once are answered as each by itself, motions of like length beside each other."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from tests.evaluation.toys import Echo, Evaluated, model, seeds

from kinema.evaluation.changed import Lifted
from kinema.evaluation.protocol import EvaluationProtocol, evaluate_replication
from kinema.evaluation.remembered import Remembered
from kinema.evaluation.source import answers
from kinema.evaluation.sources import Edited, Generated, RealMotion, ShuffledCaptions
from kinema.evaluation.together import join, select
from kinema.motion.skeleton import get_skeleton

LENGTHS = ([40, 8, 16, 28], [12, 40, 8, 32, 20], [24])


class Asked(Echo):
    """Remember the lengths of every batch."""

    def __init__(self):
        super().__init__()
        self.batches = []

    def sample(self, text, frames, *, seeds, known=None, sampling=None):
        lengths = known.latents.frames if frames is None else frames
        self.batches.append(lengths.tolist())
        return super().sample(text, lengths, seeds=seeds, sampling=2.0)


def questions(make):
    batches = [make.batch(size=len(n), lengths=n, seed=i) for i, n in enumerate(LENGTHS)]
    return [(batch, seeds(len(batch.lengths)) + 100 * i) for i, batch in enumerate(batches)]


def assert_same(found, wanted):
    for one, other in zip(found, wanted, strict=True):
        assert torch.equal(one.lengths, other.lengths)
        assert torch.equal(one.features[one.mask], other.features[other.mask])
        assert not one.features[~one.mask].any()
        assert one.captions == other.captions
        assert one.clip_ids == other.clip_ids


@pytest.mark.parametrize("kind", [Generated, lambda *a, **k: Edited(*a, task="prefix", **k)], ids=["made", "edited"])
def test_rows_of_like_length_are_made_beside_each_other_and_answered_in_order(make, kind):
    alone, together = Asked(), Asked()
    asked = questions(make)
    wanted = [kind(model(alone))(*one) for one in asked]
    assert_same(kind(model(together), batch_size=4).answer_all(asked), wanted)
    assert together.batches == [[40, 40, 32, 28], [24, 20, 16, 12], [8, 8]]
    assert [sorted(lengths) for lengths in alone.batches] == [sorted(lengths) for lengths in LENGTHS]
    assert kind(model(together)).answer_all([]) == []


def test_what_wraps_a_source_asks_it_at_once_and_one_that_mixes_rows_is_asked_batch_by_batch(make, tmp_path):
    asked, together = questions(make), Asked()
    source = Lifted(Remembered(Generated(model(together)), tmp_path), get_skeleton("humanml3d"))
    wanted = [Lifted(Generated(model(Asked())), get_skeleton("humanml3d"))(*one) for one in asked]
    assert_same(answers(source, asked), wanted)
    assert len(together.batches) == 1
    assert_same(answers(ShuffledCaptions(), asked[:2]), [ShuffledCaptions()(*one) for one in asked[:2]])


def test_kept_motion_is_given_and_the_rest_alone_is_made(make, tmp_path):
    asked = questions(make)
    wanted = Remembered(Generated(model(Asked())), tmp_path)(*asked[1])
    generator = Asked()
    source = Remembered(Generated(model(generator)), tmp_path)
    found = source.answer_all([*asked, asked[0]])
    assert_same([found[1], found[3]], [wanted, found[0]])
    assert generator.batches == [[40, 8, 16, 28, 24]]
    assert_same(source.answer_all(asked), found[:3])
    assert len(generator.batches) == 1


def test_what_is_measured_is_of_a_motion_however_many_are_asked_for(make, tmp_path):
    asked = questions(make)
    source = Generated(model(Evaluated()), batch_size=4)
    source.answer_all(asked)
    assert source.measured() == {"denoiser_calls": 3, "denoiser_rows": 6}
    kept = Remembered(Generated(model(Evaluated()), batch_size=4), tmp_path)
    kept.answer_all(asked)
    assert kept.measured() == {"denoiser_calls": 3, "denoiser_rows": 6}


def test_a_replication_has_the_same_numbers_whatever_is_made_at_once(make):
    """Twelve pools are asked in two goes, the repeats of MultiModality in one each."""
    protocol = EvaluationProtocol(pool=4, mm_texts=6, mm_repeats=5, mm_pairs=2, diversity_pairs=20)
    work = [make.batch(size=4, seed=i) for i in range(12)]

    def numbers(size):
        generator = Asked()
        source = Generated(model(generator), batch_size=size)
        return evaluate_replication(source, work, make.matching(), protocol=protocol).metrics, generator.batches

    found, batches = numbers(32)
    assert [len(lengths) for lengths in batches] == [32, 16, 8, 16]
    assert found == pytest.approx(numbers(3)[0], rel=1e-5, abs=1e-6)
    assert evaluate_replication(RealMotion(), work, make.matching(), protocol=protocol).metrics["fid"] < 1e-6


def test_batches_are_put_together_and_taken_apart(make):
    batches = [batch for batch, _ in questions(make)]
    whole = join(batches)
    assert whole.lengths.tolist() == [n for lengths in LENGTHS for n in lengths]
    part = select(whole, torch.arange(4, 9))
    assert part.features.shape[1] == 40
    assert torch.equal(part.features, batches[1].features[:, :40])
    assert part.captions == batches[1].captions
    assert join([batches[0], replace(batches[1], entries=None)]).entries is None

"""Sources answer the captions they are given, in order, and each row by its own seed."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
import torch
from tests.evaluation.toys import Echo, Evaluated, Halves, letters, model, seeds

from kinema.data.synthetic import synthetic_catalog
from kinema.evaluation.changed import FeetLocked, Lifted
from kinema.evaluation.perturbed import Perturbed, judged
from kinema.evaluation.sources import (
    Edited,
    Generated,
    NearestTrainingCaption,
    NoiseCodes,
    NoiseLatents,
    RealMotion,
    Reconstruction,
    ShuffledCaptions,
)
from kinema.generators import LatentModel
from kinema.motion.body_parts import columns_of
from kinema.motion.features import extract
from kinema.motion.lifting import lift
from kinema.motion.representation import Representation
from kinema.motion.skeleton import HUMANML3D
from kinema.motion.statistics import Statistics
from kinema.types import LatentSpace, MotionBatch, frame_mask

SOURCES = {
    "real": lambda: RealMotion(),
    "shuffled": lambda: ShuffledCaptions(),
    "reconstruction": lambda: Reconstruction(Halves()),
    "noise": lambda: NoiseLatents(Halves(), torch.zeros(67), torch.ones(67)),
    "generated": lambda: Generated(model(), sampling=2.0),
}


@pytest.mark.parametrize("name", SOURCES)
def test_answers_keep_captions_and_are_zero_past_their_lengths(make, name):
    source, batch = SOURCES[name](), make.batch()
    found = source(batch, seeds(8))
    assert (found.captions, found.clip_ids) == (batch.captions, batch.clip_ids)
    assert not found.features[~found.mask].any()
    assert sorted(found.lengths.tolist()) == sorted(batch.lengths.tolist())
    assert torch.equal(found.features, SOURCES[name]()(batch, seeds(8)).features)


@pytest.mark.parametrize("name", ["noise", "generated"])
def test_a_row_depends_on_its_own_seed_only(make, name):
    source, batch = SOURCES[name](), make.batch(lengths=[40, 12, 8, 40, 20, 16, 4, 32])
    whole = source(batch, seeds(8))
    rows = torch.tensor([6, 1])
    some = MotionBatch(batch.features[rows], batch.lengths[rows], captions=[batch.captions[i] for i in rows])
    part = source(some, seeds(8)[rows])
    for i, row in enumerate(rows.tolist()):
        length = int(batch.lengths[row])
        torch.testing.assert_close(part.features[i, :length], whole.features[row, :length])
    other = source(batch, seeds(8) + 100)
    assert (other.features != whole.features).any(-1)[whole.mask].all()


def test_shuffled_captions_never_meet_their_own_motion(make):
    batch = make.batch()
    batch.features[:, 0, 0] = torch.arange(8.0)
    for seed in range(20):
        found = ShuffledCaptions()(batch, torch.full((8,), seed))
        dealt = found.features[:, 0, 0].int().tolist()
        assert sorted(dealt) == list(range(8))
        assert all(motion != row for row, motion in enumerate(dealt))
        assert torch.equal(found.lengths, batch.lengths[dealt])
    with pytest.raises(ValueError, match="batch of 1"):
        ShuffledCaptions()(make.batch(size=1), seeds(1))


class Store:
    """Hold a few training clips."""

    def __init__(self, make):
        self.clips = [np.full((frames, 263), i + 1, np.float32) for i, frames in enumerate((43, 9, 30))]
        self.captions = [[make.caption(7), make.caption(3)], [make.caption(1)], []]

    def entry_captions(self, entry):
        return self.captions[entry]

    def frames_of(self, entry):
        return self.clips[entry]


def test_the_nearest_training_caption_gives_its_clip(make):
    source = NearestTrainingCaption(Store(make), np.arange(3), letters)
    batch = make.batch(size=4, lengths=[40, 40, 12, 4])
    batch.captions = [make.caption(i) for i in (3, 1, 7, 1)]
    found = source(batch, seeds(4))
    assert found.lengths.tolist() == [40, 8, 12, 4]
    assert [set(f[:n].flatten().tolist()) for f, n in zip(found.features, found.lengths, strict=True)] == [
        {1.0},
        {2.0},
        {1.0},
        {2.0},
    ]
    assert not found.features[~found.mask].any()
    with pytest.raises(ValueError, match="none of the training entries has a caption"):
        NearestTrainingCaption(Store(make), [2], letters)


def test_lengths_are_real_estimated_or_the_generators_own(make):
    class Estimator(LatentModel):
        def loss(self, latents, text, *, generator=None, shard=(0, 1)):
            raise ValueError("nothing to learn")

        def predict(self, text, seeds):
            return torch.full_like(seeds, 20)

    batch = make.batch()
    options = {"sampling": 2.0, "lengths": "predicted"}
    estimated = Generated(model(length=Estimator()), **options)(batch, seeds(8))
    own = Generated(model(Echo(predicts_length=True)), **options)(batch, seeds(8))
    assert set(estimated.lengths.tolist()) == {20}
    assert set(own.lengths.tolist()) == {12}
    with pytest.raises(ValueError, match="needs a generator that ends its sequences itself or a length estimator"):
        Generated(model(), **options)
    with pytest.raises(ValueError, match="allowed: real, predicted"):
        Generated(model(), lengths="guess")


class Codes(Halves):
    """Decode each code to four frames that hold the first layer's number."""

    space = LatentSpace("codes", 1, 49, 4, codebook_size=3, quantizers=2)

    def decode(self, latents):
        features = latents.codes[..., :1].repeat_interleave(4, dim=1).expand(-1, -1, 67).float()
        return MotionBatch(features, latents.frames)


def test_noise_codes_follow_the_training_shares(make):
    batch = make.batch()
    shares = torch.tensor([[0.5, 0.0, 0.5], [0.0, 1.0, 0.0]])
    noise = NoiseCodes(Codes(), shares)
    features = noise(batch, seeds(8)).features
    real = torch.arange(features.shape[1]) < (batch.lengths // 4 * 4)[:, None]
    drawn = features[..., 0][real]
    assert set(drawn.tolist()) == {0.0, 2.0}
    assert 0.35 < (drawn == 2).float().mean() < 0.65
    assert torch.equal(noise(batch, seeds(8)).features, features)


@pytest.mark.parametrize("task", ["prefix", "suffix", "inbetween", "outpaint"])
def test_an_edit_sees_nothing_of_the_frames_it_replaces(make, task):
    """Change all frames outside of the kept ones: the answer is bit-equal."""
    seen = []

    class Keeps(Echo):
        def sample(self, text, frames, *, seeds, known=None, sampling=None):
            seen.append(known)
            return known.latents

    batch = make.batch()
    edited = Edited(model(Keeps()), task=task, paste=True)
    first = edited(batch, seeds(8))
    kept = seen[0].mask.repeat_interleave(4, dim=1)
    counts = batch.lengths // 4
    assert (seen[0].mask.sum(1) <= counts - counts // 4).all()
    assert (seen[0].mask.sum(1) > 0).all()
    size = kept.shape[1]
    assert torch.equal(first.features[kept], batch.features[:, :size, :67][kept])
    assert torch.equal(edited.kept(batch.lengths), kept)  # and what is watched says which frames these are
    assert RealMotion().kept(batch.lengths) is None
    changed = torch.where(kept[..., None], batch.features[:, :size], torch.randn_like(batch.features[:, :size]))
    second = edited(replace(batch, features=changed), seeds(8))
    assert torch.equal(first.features, second.features)
    assert torch.equal(seen[0].latents.values, seen[1].latents.values)


def test_an_unknown_editing_task_is_refused_at_once():
    with pytest.raises(ValueError, match="middle"):
        Edited(model(), task="middle")


def test_a_generated_source_counts_what_passes_through_the_networks(make):
    source, batch = Generated(model(Evaluated())), make.batch()
    size = len(batch.lengths)
    for _ in range(2):
        source(batch, seeds(size))
    assert source.measured() == {"denoiser_calls": 3, "denoiser_rows": 6}
    assert source.measured() == {"denoiser_calls": 0, "denoiser_rows": 0}


def perturbed(batch, seeds, **options):
    statistics = Statistics(np.linspace(-1, 1, 263), np.linspace(0.5, 2, 263))
    return Perturbed(HUMANML3D, statistics, **options)(batch, seeds).features, statistics


@pytest.mark.parametrize(("altered", "columns"), [("essential", slice(0, 67)), ("redundant", slice(67, 263))])
@pytest.mark.parametrize("how", ["add", "replace"])
def test_perturbed_motion_is_altered_in_the_named_dims_alone(altered, columns, how):
    lengths, generator = torch.tensor([40, 196]), torch.Generator().manual_seed(0)
    features = torch.randn(2, 196, 263, generator=generator) * frame_mask(lengths, 196)[..., None]
    batch, seeds = MotionBatch(features, lengths), torch.tensor([3, 4])
    found, statistics = perturbed(batch, seeds, altered=altered, how=how, level=0.5)
    kept = torch.ones(263, dtype=torch.bool)
    kept[columns] = False
    assert torch.equal(found[..., kept], features[..., kept])
    assert not found[0, 40:].any()  # padding stays zero
    noise = found[1][:, columns] - (features[1][:, columns] if how == "add" else torch.tensor(statistics.mean[columns]))
    z = noise / torch.tensor(statistics.std[columns])
    assert z.std().item() == pytest.approx(0.5, rel=0.02)
    assert z.mean().item() == pytest.approx(0, abs=0.02)


def test_perturbed_motion_depends_on_its_own_seed_and_not_on_its_batch():
    lengths = torch.tensor([40, 196])
    batch = MotionBatch(torch.zeros(2, 196, 263), lengths)
    both, _ = perturbed(batch, torch.tensor([3, 4]), altered="redundant", how="add", level=1.0)
    alone, _ = perturbed(
        MotionBatch(torch.zeros(1, 40, 263), lengths[:1]), torch.tensor([3]), altered="redundant", how="add", level=1.0
    )
    assert torch.equal(both[0, :40], alone[0])
    other, _ = perturbed(batch, torch.tensor([5, 4]), altered="redundant", how="add", level=1.0)
    assert not torch.equal(other[0], both[0])
    assert torch.equal(other[1], both[1])


def test_a_judges_deviations_are_those_it_normalises_by():
    corpus = Statistics(np.linspace(-1, 1, 263), np.linspace(0.5, 2, 263))
    for kind, variant in (("redundant", "published"), ("essential", "raw")):
        representation = Representation(kind, "humanml3d", variant).fit(corpus)
        found = judged(representation, corpus)
        assert found.std[0] == pytest.approx(corpus.std[0] / (25 if variant == "published" else 1))
        np.testing.assert_allclose(found.std[67:200], corpus.std[67:200], rtol=1e-6)
        np.testing.assert_allclose(found.mean, corpus.mean, rtol=1e-6)


@pytest.mark.parametrize("wrong", [{"altered": "all"}, {"how": "scale"}, {"level": -1.0}, {"level": float("nan")}])
def test_perturbation_names_what_is_allowed(wrong):
    options = {"altered": "essential", "how": "add", "level": 1.0} | wrong
    with pytest.raises(ValueError, match="allowed: dims essential, redundant; how add, replace; level of at least 0"):
        Perturbed(HUMANML3D, Statistics(np.zeros(263), np.ones(263)), **options)


def test_lifted_motion_keeps_its_essential_dims_and_its_padding():
    lengths = torch.tensor([8, 12])
    features = torch.randn(2, 12, 67, generator=torch.Generator().manual_seed(0)) * 0.1
    batch = MotionBatch(features * frame_mask(lengths, 12)[..., None], lengths)
    found = Lifted(RealMotion(), HUMANML3D)(batch, torch.tensor([0, 1]))
    assert found.features.shape == (2, 12, 263)
    assert torch.equal(found.features[..., :67], batch.features)
    assert not found.features[0, 8:].any()
    alone = Lifted(RealMotion(), HUMANML3D)(MotionBatch(batch.features[:1, :8], lengths[:1]), torch.tensor([0]))
    assert torch.equal(found.features[0, :8], alone.features[0])


@pytest.mark.parametrize("width", [67, 263])
def test_held_feet_leave_root_arms_and_padding_and_are_told_in_full_rows_too(width):
    clips = islice(synthetic_catalog(size=12, seed=4), 3)
    made = [lift(extract(clip.joints(), HUMANML3D)[:40], HUMANML3D) for clip in clips]
    for motion in made:
        motion[:, 1] += 0.02  # feet slide at 0.4 m/s
    lengths = torch.tensor([30, 40, 20])
    features = torch.from_numpy(np.stack(made))[..., :width] * frame_mask(lengths, 40)[..., None]
    found = FeetLocked(RealMotion(), HUMANML3D)(MotionBatch(features, lengths), torch.arange(3))
    lower = torch.from_numpy(columns_of("lower", HUMANML3D)[:67])
    assert torch.equal(found.features[..., :4], features[..., :4])
    assert torch.equal(found.features[..., :67][..., ~lower], features[..., :67][..., ~lower])
    assert found.features.shape == features.shape
    assert not found.features[0, 30:].any()
    assert (found.features - features).abs()[..., :67].amax((1, 2)).max() > 0.01
    if width == 263:
        again = lift(found.features[0, :30, :67].numpy(), HUMANML3D)
        np.testing.assert_array_equal(found.features[0, :30].numpy(), again)


def test_generated_motion_is_timed_apart_from_what_is_measured(make, monkeypatch):
    clock = iter((0.0, 4.0, 10.0, 12.0))
    monkeypatch.setattr("kinema.evaluation.stopwatch.time.perf_counter", lambda: next(clock))
    source = Generated(model(), sampling=2.0)
    for size in (8, 4):
        source(make.batch(size=size), seeds(size))
    assert FeetLocked(source, HUMANML3D).seconds() == pytest.approx(6 / 12)
    assert source.seconds() is None
    assert "seconds" not in " ".join(source.measured())
    assert RealMotion().seconds() is None

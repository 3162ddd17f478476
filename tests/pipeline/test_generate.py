"""Text comes out as motion of the asked length, the same for the same seed, whatever else is in the batch."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from kinema.devices import find_device
from kinema.motion.recovery import recover_joints
from kinema.pipeline.arguments import frame_counts
from kinema.pipeline.text_to_motion import TextToMotion
from kinema.seeds import request_seeds

TEXTS = ["a person walks", "a man jumps twice", "someone waves"]
CLOSE = {"rtol": 1e-4, "atol": 1e-4}


def same(a, b):
    assert [m.text for m in a] == [m.text for m in b]
    for one, other in zip(a, b, strict=True):
        np.testing.assert_allclose(one.features, other.features, **CLOSE)


def test_options_that_the_model_cannot_sample_by_are_refused(model, monkeypatch):
    monkeypatch.setattr(model.generator, "condition_drop", 0.0)
    with pytest.raises(ValueError, match="but condition_drop=0 gave this model no empty text"):
        model.generate("a person walks", 40, seed=1)
    with pytest.raises(ValueError, match="solver"):
        model.generate("a person walks", 40, seed=1, guidance=1.0, solver="ddim")
    assert model.generate("a person walks", 40, seed=1, guidance=1.0)


@pytest.mark.parametrize("frames", [1, 37, 40, 196])
def test_any_length_comes_out_exactly(model, frames):
    (motion,) = model.generate("a person walks", frames, seed=1)
    assert motion.joints.shape == (frames, 22, 3)
    assert motion.features.shape == (frames, 67)
    assert motion.features[-1].any()
    assert (motion.skeleton, motion.fps, motion.text, motion.seed) == ("humanml3d", 20, "a person walks", 1)
    joints = recover_joints(torch.from_numpy(motion.features), model.skeleton).numpy()
    np.testing.assert_allclose(motion.joints, joints, atol=1e-5)


def test_the_same_seed_gives_the_same_motions_whatever_the_batches(model):
    frames = [37, 60, 16]
    motions = model.generate(TEXTS, frames, seed=5)
    same(model.generate(TEXTS, frames, seed=5), motions)
    same(model.generate(TEXTS, frames, seed=5, batch_size=1), motions)
    same(model.generate(TEXTS, frames, seed=5, batch_size=2), motions)
    assert np.abs(model.generate(TEXTS[0], 37, seed=6)[0].features - motions[0].features).max() > 0.01


def test_a_motions_own_seed_repeats_it_alone(model):
    motions = model.generate(TEXTS, 20)
    for motion in motions:
        same(model.generate(motion.text, 20, seed=motion.seed), [motion])
    same(model.generate(TEXTS, 20, seed=motions[0].seed), motions)


def test_seeds_differ_and_the_global_state_is_left_alone(model):
    seeds = request_seeds(7, 1000)
    assert seeds[0] == 7
    assert len(set(seeds)) == 1000
    assert request_seeds(7, 3) == seeds[:3]
    assert request_seeds(None, 1) != request_seeds(None, 1)
    state = torch.get_rng_state()
    model.generate("a person walks", 16, seed=1)
    assert torch.equal(torch.get_rng_state(), state)


def test_text_and_sampling_matter(model):
    base = model.generate("a person walks", 20, seed=1)[0].features
    assert np.abs(model.generate("a man jumps", 20, seed=1)[0].features - base).max() > 1e-3
    assert np.abs(model.generate("a person walks", 20, seed=1, guidance=5.0)[0].features - base).max() > 1e-3


def test_lengths_in_seconds_or_from_the_text(model):
    assert [len(m.joints) for m in model.generate(TEXTS[:2], seconds=[1.0, 2.5], seed=0)] == [20, 50]
    motions = model.generate(TEXTS, seed=3)
    assert all(4 <= len(m.joints) <= 196 for m in motions)
    same(model.generate(TEXTS, seed=3, batch_size=1), motions)


def test_some_lengths_are_given_and_others_are_the_models_to_say(model):
    mixed = model.generate(TEXTS, [24, None, 37], seed=3)
    given, estimated = model.generate(TEXTS, [24, 30, 37], seed=3), model.generate(TEXTS, seed=3)
    same([mixed[0], mixed[2]], [given[0], given[2]])
    same([mixed[1]], [estimated[1]])
    with pytest.raises(ValueError, match="a length each, or none"):
        model.chain(TEXTS, [24, None, 37])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"texts": "  "}, "text 0 is empty"),
        ({"texts": []}, "no texts"),
        ({"frames": 0}, "length 0 is out of range; allowed: 1 to 196 frames"),
        ({"frames": 197}, r"length 197 is out of range; allowed: 1 to 196 frames \(9.8 seconds at 20"),
        ({"frames": None, "seconds": 60.0}, "length 1200"),
        ({"frames": None, "seconds": 1e308}, "length of more than 1,000,000,000 frames is out of range"),
        ({"frames": 40, "seconds": 2.0}, "give one of them"),
        ({"frames": [40, 40]}, "2 lengths for 1 texts"),
        ({"guidence": 3}, "unknown sampling field 'guidence'; allowed: steps, guidance"),
        ({"steps": 0}, "sampling.steps=0: must be a whole number"),
        ({"seed": -1}, "seed=-1: must be a whole number"),
        ({"batch_size": 0}, "batch_size=0: must be a whole number"),
    ],
)
def test_bad_requests_are_named(model, arguments, message):
    with pytest.raises(ValueError, match=message):
        model.generate(**{"texts": "a person walks", "frames": 20, **arguments})


def test_a_part_of_a_frame_is_refused():
    with pytest.raises(ValueError, match=r"frames=40\.5: must be a whole number"):
        frame_counts(40.5, None, 1, fps=20, maximum=196)


def test_no_length_and_nothing_to_estimate_it(model):
    bare = TextToMotion(model.tokenizer, model.generator, model.text_encoder)
    with pytest.raises(ValueError, match="no length: give frames= or seconds="):
        bare.generate("a person walks")


def test_a_model_in_training_stays_in_training(model):
    expected = model.generate("a person walks", 20, seed=1)
    model.tokenizer.train(), model.generator.train()
    try:
        same(model.generate("a person walks", 20, seed=1), expected)
        assert model.tokenizer.training
        assert model.generator.training
    finally:
        model.tokenizer.eval(), model.generator.eval()


def test_a_device_is_chosen(model):
    assert model.to(find_device()).device.type == find_device().type
    model.to("cpu")

"""What `task=control` asks for: joints that are where they were asked to be (FRONTIER §2.8)."""

from __future__ import annotations

import pytest
import torch
from tests.contracts.conftest import SMALL

from kinema.evaluation.controlled import FRAMES, Controlled
from kinema.experiments.config import compose
from kinema.experiments.evaluation import run_evaluation
from kinema.pipeline import TextToMotion

WRISTS = ("left_wrist", "right_wrist")


@pytest.fixture(scope="module")
def model(workshop) -> TextToMotion:
    parts = workshop.tokenizer("method=msflow"), workshop.make("generator", "method=msflow").eval()
    return TextToMotion(*parts, workshop.text)


@pytest.fixture(scope="module")
def clips(workshop):
    return workshop.clips(8)


def test_held_joints_are_exactly_where_they_are_asked_to_be(model, clips):
    source = Controlled(model, joints=WRISTS, density="five")
    made = source(clips, torch.arange(8))
    assert made.lengths.tolist() == clips.lengths.tolist()
    assert made.features.isfinite().all()
    assert source.measured() == {"control_cm": 0.0, "control_places_missed": 0.0, "control_motions_missed": 0.0}
    assert source.measured() == {}  # told once


def test_a_method_that_is_not_told_misses(model, clips, monkeypatch):
    source = Controlled(model, joints=WRISTS, density="all")
    free = model.sample_latents
    monkeypatch.setattr(
        model, "sample_latents", lambda text, seeds, known, sampling: free(text, clips.lengths, seeds=seeds)
    )
    source(clips, torch.arange(8))
    measured = source.measured()
    assert measured["control_cm"] > 1
    assert 0 < measured["control_places_missed"] < measured["control_motions_missed"] <= 1


@pytest.mark.parametrize("density", [*FRAMES, "mixed"])
def test_what_is_held_is_drawn_by_a_motions_own_seed(model, density):
    source, lengths = Controlled(model, joints=WRISTS, density=density), torch.tensor([40, 60, 44])
    held = source.held(lengths, torch.tensor([5, 6, 7]), 60)
    assert torch.equal(held[1], source.held(lengths[1:2], torch.tensor([6]), 60)[0])
    assert not held[0, 40:].any()
    names = model.skeleton.joint_names
    assert {names[j] for j in held.any(1).any(0).nonzero().flatten().tolist()} == set(WRISTS)
    counts = held.any(2).sum(1).tolist()
    allowed = FRAMES.values() if density == "mixed" else [FRAMES[density]]
    assert all(count in {rule(length) for rule in allowed} for count, length in zip(counts, [40, 60, 44], strict=True))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (["method=msflow", "control.joints=[nose]"], "control.joints: 'nose' is no joint of humanml3d; it has pelvis,"),
        (
            ["method=latent_flow"],
            r"the frames of method=latent_flow \(tokenizer=ae_2x\) hold none; choose a method in XYZ",
        ),
        (["method=msflow", "control.density=3"], "must be one of one, two, five, quarter, all, mixed"),
        (["method=msflow", "source=real"], "task=control with source=real; only source=generation has tasks"),
    ],
)
def test_what_cannot_be_held_is_told_before_anything_trains(workshop, changes, message):
    asked = [*SMALL, *workshop.paths, "source=generation", "task=control", *changes]
    with pytest.raises(ValueError, match=message):
        run_evaluation(compose(asked, "evaluate"))

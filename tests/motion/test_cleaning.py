"""Feet are held in joints and rows alike, over the floor that the rows know, and what changed is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from kinema.data.synthetic import synthetic_catalog
from kinema.motion.cleaning import Held, described, floor_of, lock_rows
from kinema.motion.features import extract
from kinema.motion.recovery import recover_joints
from kinema.motion.skeleton import HUMANML3D
from kinema.types import Motion


@pytest.fixture(scope="module")
def motion():
    """A motion as models make it, whose feet slide; it stands 30 cm above the origin."""
    clip = next(iter(synthetic_catalog(size=12, seed=4)))
    rows = extract(clip.joints(), HUMANML3D)[:60]
    rows[:, 1] += 0.03  # 0.6 m/s
    joints = recover_joints(torch.from_numpy(rows), HUMANML3D).numpy()
    return Motion(joints + np.array([0, 0.3, 0], np.float32), rows, "", "humanml3d", 20.0)


def test_rows_and_joints_are_held_alike(motion):
    held = Held.of(motion, floor_of(motion))
    again = recover_joints(torch.from_numpy(held.motion.features), HUMANML3D).numpy()
    np.testing.assert_allclose(again + np.array([0, 0.3, 0]), held.motion.joints, atol=2e-5)
    assert np.abs(held.motion.joints - motion.joints).max() > 0.02
    assert held.motion.joints[..., 1].min() >= motion.joints[..., 1].min() - 1e-6


def test_figures_say_that_standing_feet_stay(motion):
    held = Held.of(motion, floor_of(motion))
    before, after = held.figures(held.before), held.figures(held.after)
    assert before["skating"] > 30 > 5 > after["skating"]
    assert before["drift"] > 4 > 0.1 > after["drift"]
    assert held.farthest == pytest.approx(100 * np.linalg.norm(held.after - held.before, axis=-1).max(), rel=1e-5)
    said = described([held, replace(held, before=held.after)])
    assert f"drift {(before['drift'] + after['drift']) / 2:.1f} -> {after['drift']:.1f} cm" in said


def test_one_frame_stays_as_it_is(motion):
    assert np.array_equal(lock_rows(motion.features[:1], HUMANML3D), motion.features[:1])

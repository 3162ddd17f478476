"""Feet that stand are held: they slide less, bones keep their lengths, nothing but the legs moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from kinema.data.synthetic import synthetic_catalog
from kinema.motion.feet import contacts, drift, legs, lock_feet, runs
from kinema.motion.kinematics import bone_lengths
from kinema.motion.physics import foot_skating
from kinema.motion.rotation import unit
from kinema.motion.skeleton import HUMANML3D

LEGS = [joint for leg in legs(HUMANML3D) for joint in (leg.knee, leg.ankle, leg.toe)]
OTHERS = [joint for joint in range(22) if joint not in LEGS]


@pytest.fixture(scope="module")
def clips():
    return [clip.joints().astype(np.float64) for clip in synthetic_catalog(size=40, seed=5)][:20]


def sliding(joints: np.ndarray, speed: float = 0.6) -> np.ndarray:
    """Let the whole body drift: every standing foot slides."""
    drift = np.arange(len(joints))[:, None] * speed / 20 * np.array([0.6, 0, 0.8])
    return joints + drift[:, None]


def skating(clips: list[np.ndarray]) -> float:
    found = [foot_skating(torch.tensor(j)[None].float(), torch.tensor([len(j)]), HUMANML3D) for j in clips]
    return float(torch.cat(found).mean())


def test_the_legs_are_the_skeletons_chains():
    assert [HUMANML3D.joint_names[j] for j in LEGS[:3]] == ["left_knee", "left_ankle", "left_foot"]


def test_sliding_feet_slide_less_and_nothing_but_legs_moves(clips):
    slid = [sliding(joints) for joints in clips]
    locked = [lock_feet(joints, HUMANML3D, 20) for joints in slid]
    assert skating(locked) < 0.5 * skating(slid)
    for before, after in zip(slid, locked, strict=True):
        np.testing.assert_array_equal(after[:, OTHERS], before[:, OTHERS])
        np.testing.assert_allclose(bone_lengths(after, HUMANML3D), bone_lengths(before, HUMANML3D), atol=1e-6)
        assert after[:, [10, 11], 1].min() > min(0, before[:, [10, 11], 1].min()) - 1e-9


def test_a_foot_that_stands_stands_still(clips):
    joints = np.tile(clips[0][:1], (30, 1, 1))
    joints[..., 1] -= joints[..., 1].min()
    locked = lock_feet(sliding(joints, 0.2), HUMANML3D, 20)
    assert np.ptp(locked[:, 10], axis=0).max() < 0.02


def test_a_foot_that_slides_far_takes_a_step(clips):
    joints = np.tile(clips[0][:1], (40, 1, 1))
    joints[..., 1] -= joints[..., 1].min()
    joints = sliding(joints, 0.4)
    toe = lock_feet(joints, HUMANML3D, 20)[:, 10]
    assert runs(contacts(toe, 20)) == [(0, 18), (22, 40)]
    assert np.linalg.norm(toe[-1] - toe[0]) > 0.3
    assert max(drift(toe, contacts(toe, 20))) < 0.01
    assert max(drift(joints[:, 10], contacts(toe, 20))) == pytest.approx(17 * 0.02)
    assert toe[20, 1] > 0.05
    assert skating([joints]) == 0  # slow sliding, that the metric does not see


def test_a_body_that_stands_still_stays_as_it_is(clips):
    joints = np.tile(clips[0][:1], (30, 1, 1))
    joints[..., 1] -= joints[..., 1].min()
    np.testing.assert_allclose(lock_feet(joints, HUMANML3D, 20), joints, atol=1e-9)


def test_a_motion_moved_and_at_another_rate_is_locked_alike(clips):
    joints = sliding(clips[1])
    moved = lock_feet(joints + np.array([5, 0, -3]), HUMANML3D, 20)
    np.testing.assert_allclose(moved - np.array([5, 0, -3]), lock_feet(joints, HUMANML3D, 20), atol=1e-9)


def test_contacts_are_low_slow_and_long_enough():
    toe = np.zeros((40, 3))
    toe[10:12, 1] = 0.2  # a gap of two frames is closed
    toe[20:, 0] = np.arange(20) * 0.1  # 2 m/s
    toe[30, 0] = toe[29, 0]
    assert runs(contacts(toe, 20)) == [(0, 20)]


@pytest.fixture(scope="module")
def slid():
    clips = [clip.joints().astype(np.float64) for clip in synthetic_catalog(size=40, seed=5)][:4]
    return [j + np.arange(len(j))[:, None, None] * 0.03 * np.array([0.6, 0, 0.8]) for j in clips]


def side(joints, leg):
    axis = unit(joints[:, leg.ankle] - joints[:, leg.hip])
    way = joints[:, leg.knee] - joints[:, leg.hip]
    return way - (way * axis).sum(-1, keepdims=True) * axis


def test_knees_bend_to_the_side_that_they_were_bent_to(slid):
    for before in slid:
        after = lock_feet(before, HUMANML3D, 20)
        for leg in legs(HUMANML3D):
            assert ((side(before, leg) * side(after, leg)).sum(-1) >= 0).all()


def test_rate_and_unit_are_the_skeletons(slid):
    toe = np.zeros((12, 3))
    toe[:, 0] = np.arange(12) * 0.02
    assert contacts(toe, 20).all()  # 0.4 m/s
    assert not contacts(toe, 50).any()  # 1 m/s
    mm = replace(HUMANML3D, unit="mm")
    np.testing.assert_allclose(lock_feet(1000 * slid[0], mm, 20) / 1000, lock_feet(slid[0], HUMANML3D, 20), atol=1e-9)


def test_a_lifted_foot_at_the_start_is_no_gap():
    toe = np.zeros((40, 3))
    toe[:2, 1] = 0.2
    assert runs(contacts(toe, 20)) == [(2, 40)]


def test_a_touch_is_no_contact():
    toe = np.zeros((40, 3))
    toe[:, 1] = 0.2
    toe[10:12, 1] = 0
    assert runs(contacts(toe, 20)) == []


def test_a_foot_is_led_to_its_place_before_it_stands_there(slid):
    joints = np.tile(slid[0][:1], (60, 1, 1))
    joints[..., 1] -= joints[..., 1].min()
    joints[30:, :, 0] += np.arange(30)[:, None] * 0.0075  # standing feet slide, by .2 m
    joints[:30, :, 1] += 0.2  # and were in the air before
    moved = (lock_feet(joints, HUMANML3D, 20) - joints)[:, 10, 0]
    assert abs(moved[30]) > 0.08
    assert np.abs(np.diff(moved)).max() < 0.04

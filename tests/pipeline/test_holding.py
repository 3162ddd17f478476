"""Held frames come back where they stood, whatever is generated between them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from kinema.motion.recovery import recover_joints
from kinema.motion.rotation import rotate_yaw
from kinema.motion.skeleton import HUMANML3D
from kinema.motion.trajectory import Trajectory, between
from kinema.pipeline.editing import parse_frames
from kinema.pipeline.holding import hold


@pytest.fixture
def source(model):
    return model.generate("a person walks", 60, seed=1)[0]


@pytest.mark.parametrize("frames", [[0, 30, 59], [30], [10, 11, 50]])
def test_held_frames_stand_where_they_stood(model, source, frames):
    moved = replace(source, joints=rotate_yaw(source.joints, 1.0).astype(np.float32) + np.float32([3, 0.2, -1]))
    made = hold(model, moved, "someone turns around", frames, seed=2)
    np.testing.assert_allclose(made.motion.joints[frames], moved.joints[frames], atol=2e-3)
    assert made.away < 2e-3
    (plain,) = model.edit(moved, "someone turns around", [(a, a + 1) for a in range(60) if a not in frames], seed=2)
    kept = made.motion.kept
    assert np.array_equal(kept, plain.kept)
    assert all(kept[frame] for frame in frames)
    assert np.array_equal(made.motion.features[kept], source.features[kept])
    assert np.array_equal(made.motion.features[:, 3:], plain.features[:, 3:])  # the root's way alone is changed
    if len(frames) > 1:
        assert made.led > 0.05
        assert np.abs(plain.joints[frames[-1]] - moved.joints[frames[-1]]).max() > 0.05


def test_rows_and_joints_tell_the_same_motion(model, source):
    made = hold(model, source, "someone turns around", [0, 30, 59], seed=2).motion
    again = recover_joints(torch.from_numpy(made.features), HUMANML3D).numpy()
    np.testing.assert_allclose(again, made.joints, atol=5e-3)


def test_a_way_put_back_gives_the_rows_again(source):
    way = Trajectory.of(source.features)
    np.testing.assert_allclose(way.steer(source.features, HUMANML3D), source.features, atol=1e-5)
    np.testing.assert_allclose(way.joints(source.features, HUMANML3D), source.joints, atol=1e-5)


def test_values_are_led_gently_and_stay_a_frame():
    found = between(np.array([2, 6]), np.array([1.0, 3.0]), 9)
    assert found[[0, 1, 2, 3, 6, 7, 8]].tolist() == [1, 1, 1, 1, 3, 3, 3]
    assert (np.diff(found) >= 0).all()


def test_frames_are_read_and_wrong_ones_named():
    assert parse_frames("40,0,-1,1s", 80, 20) == [0, 20, 40, 79]
    with pytest.raises(ValueError, match="frame 80 is outside the clip; it has frames 0 to 79"):
        parse_frames("80", 80, 20)
    with pytest.raises(ValueError, match="'x' is neither a frame"):
        parse_frames("x", 80, 20)


def test_nothing_is_left_where_every_frame_is_held(model, source):
    with pytest.raises(ValueError, match="every frame is held"):
        hold(model, source, "someone sits", range(60))


def test_a_body_of_other_bones_stands_where_it_stood(model, source):
    """Joints of a file are farther apart than the rows that are fitted to them say."""
    larger = replace(source, joints=source.joints * np.float32(1.2) + np.float32([2, 0, 1]))
    assert np.linalg.norm(larger.joints[59, 0] - larger.joints[0, 0]) > 0.3
    made = hold(model, larger, "someone turns around", [0, 30, 59], seed=2)
    roots = made.motion.joints[[0, 30, 59], 0]
    np.testing.assert_allclose(roots[:, [0, 2]], larger.joints[[0, 30, 59], 0][:, [0, 2]], atol=2e-3)

"""A placement is what extraction takes away: turned and moved back, a clip is where it was."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from kinema.data.synthetic import synthetic_clips
from kinema.motion.features import extract, extract_every
from kinema.motion.placement import Placement
from kinema.motion.recovery import recover_joints
from kinema.motion.rotation import rotate_yaw
from kinema.motion.skeleton import HUMANML3D


@pytest.fixture(scope="module")
def joints():
    return next(iter(synthetic_clips(size=1, seed=0))).joints()[:61]


@pytest.mark.parametrize("yaw", [0.0, 0.3, 1.5, 3.1, -3.1])
@pytest.mark.parametrize("step", [(0, 0, 0), (2, 0, 0), (0, 0.9, 0), (-50, -1, 20)])
def test_what_extraction_takes_away_is_given_back(joints, yaw, step):
    placed = rotate_yaw(joints, yaw) + np.array(step)
    rows = recover_joints(torch.from_numpy(extract(placed, HUMANML3D)), HUMANML3D).numpy()
    back = Placement.between(rows, placed, HUMANML3D).apply(rows)
    np.testing.assert_allclose(back, placed[:60], atol=2e-3)


def test_other_bone_lengths_keep_place_facing_and_floor(joints):
    placed = rotate_yaw(joints * 1.2, 2.0) + np.array((3, 0.5, 1))
    features = extract_every(placed, HUMANML3D, target_bone_lengths="skeleton")
    rows = recover_joints(torch.from_numpy(features), HUMANML3D).numpy()
    back = Placement.between(rows, placed, HUMANML3D).apply(rows)
    np.testing.assert_allclose(back[0, 0, [0, 2]], placed[0, 0, [0, 2]], atol=1e-4)
    assert back[..., 1].min() == pytest.approx(placed[..., 1].min(), abs=1e-3)
    again = Placement.between(back, placed, HUMANML3D)
    assert again.yaw == 0.0
    assert again.step == (0.0, 0.0, 0.0)


def test_a_motion_in_its_place_is_not_touched(joints):
    rows = joints.astype(np.float32)
    assert Placement.between(rows, rows + np.float32(1e-6), HUMANML3D).apply(rows) is rows


def test_every_frame_has_a_row_and_all_but_the_last_are_those_of_extraction(joints):
    rows = extract_every(joints, HUMANML3D, target_bone_lengths="skeleton")
    assert len(rows) == len(joints)
    assert np.array_equal(rows[:-1], extract(joints, HUMANML3D, target_bone_lengths="skeleton"))
    moving = HUMANML3D.groups["velocities"]
    assert np.array_equal(rows[-1, moving], rows[-2, moving])
    with pytest.raises(ValueError, match=r"joints have shape \(1, 22, 3\)"):
        extract_every(joints[:1], HUMANML3D)

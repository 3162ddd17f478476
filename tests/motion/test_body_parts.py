"""The upper body's columns are those of its joints alone, on both skeletons."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from kinema.motion.body_parts import columns_of, legs
from kinema.motion.recovery import recover_joints
from kinema.motion.skeleton import SKELETONS, get_skeleton


def test_the_lower_joints_are_the_published_ones():
    assert legs(get_skeleton("humanml3d")) == {0, 1, 2, 4, 5, 7, 8, 10, 11}  # MDM §5
    names = get_skeleton("kit").joint_names
    assert {names[j].split("_")[-1] for j in legs(get_skeleton("kit"))} == {
        "pelvis", "hip", "knee", "ankle", "midfoot", "toe",
    }  # fmt: skip


@pytest.mark.parametrize("name", SKELETONS)
def test_the_parts_share_no_column_and_leave_none(name):
    skeleton = get_skeleton(name)
    upper, lower = (columns_of(part, skeleton) for part in ("upper", "lower"))
    assert np.array_equal(upper, ~lower)
    joints = skeleton.num_joints - len(legs(skeleton))
    assert upper.sum() == joints * (3 + 6 + 3)
    for group in ("root_yaw", "root_linear", "root_height", "contacts"):
        assert lower[skeleton.groups[group]].all()


@pytest.mark.parametrize("name", SKELETONS)
def test_new_upper_columns_move_no_joint_of_the_legs(name):
    skeleton = get_skeleton(name)
    rows = torch.randn(12, skeleton.feature_width, generator=torch.Generator().manual_seed(0))
    upper = torch.from_numpy(columns_of("upper", skeleton))
    other = torch.where(upper, rows + 1, rows)
    moved = (recover_joints(rows, skeleton) != recover_joints(other, skeleton)).any(-1).all(0)
    assert set((~moved).nonzero()[:, 0].tolist()) == legs(skeleton)

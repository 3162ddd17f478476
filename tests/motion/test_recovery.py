from __future__ import annotations

import math

import pytest
import torch

from kinema.motion.recovery import joints_from_rotations, recover_joints, recover_root
from kinema.motion.skeleton import HUMANML3D, KIT


def random_features(*shape):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(0)) * 0.1


def test_recovery_batches_over_any_leading_dimensions():
    features = random_features(2, 3, 10, 67)
    joints = recover_joints(features, HUMANML3D)
    assert joints.shape == (2, 3, 10, 22, 3)
    torch.testing.assert_close(joints[1, 2], recover_joints(features[1, 2], HUMANML3D))


def test_full_rows_and_their_essential_part_recover_alike():
    features = random_features(4, 10, 251)
    torch.testing.assert_close(recover_joints(features, KIT), recover_joints(features[..., :64], KIT), rtol=0, atol=0)


def test_the_root_turns_by_twice_the_angular_column_and_walks_one_frame_later():
    features = torch.zeros(3, 4)
    features[0] = torch.tensor([math.pi / 4, 0.0, 2.0, 1.0])  # turn by 90 degrees, then step forward in that heading
    yaw, position = recover_root(features)
    torch.testing.assert_close(yaw, torch.tensor([0, math.pi / 2, math.pi / 2]))
    torch.testing.assert_close(position[:, [0, 2]], torch.tensor([[0.0, 0.0], [-2.0, 0.0], [-2.0, 0.0]]))
    assert position[:, 1].tolist() == [1, 0, 0]


def test_the_last_rows_velocities_go_unused():
    features = random_features(6, 67)
    changed = features.clone()
    changed[-1, :3] += 5
    torch.testing.assert_close(recover_joints(changed, HUMANML3D), recover_joints(features, HUMANML3D))


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_is_integrated_in_float32(dtype):
    features = random_features(2, 190, 67).to(dtype)
    joints = recover_joints(features, HUMANML3D)
    assert joints.dtype == torch.float32
    torch.testing.assert_close(joints, recover_joints(features.float(), HUMANML3D))


def test_recovery_can_be_trained_through():
    features = random_features(2, 8, 67).requires_grad_()
    recover_joints(features, HUMANML3D).square().sum().backward()
    assert torch.isfinite(features.grad).all()
    assert features.grad.abs().sum() > 0


def test_narrow_rows_are_refused():
    with pytest.raises(ValueError, match=r"at least 67 columns.*got 64"):
        recover_joints(torch.zeros(5, 64), HUMANML3D)
    with pytest.raises(ValueError, match=r"at least 193 columns.*got 67"):
        joints_from_rotations(torch.zeros(5, 67), HUMANML3D)


def test_kit_rotations_need_bone_lengths():
    with pytest.raises(ValueError, match=r"'kit' has no target bone lengths"):
        joints_from_rotations(torch.zeros(5, 251), KIT)

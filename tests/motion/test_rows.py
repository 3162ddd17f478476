from __future__ import annotations

import numpy as np
import pytest
import torch

from kinema.motion.features import extract, extract_every
from kinema.motion.recovery import recover_joints
from kinema.motion.rows import essential_rows
from kinema.motion.skeleton import HUMANML3D, KIT
from kinema.motion.trajectory import Trajectory, faced


def batch(joints: list[np.ndarray], filler: float = np.nan) -> tuple[torch.Tensor, torch.Tensor]:
    """Stack clips; what pads them must not be read."""
    lengths = torch.tensor([len(clip) for clip in joints])
    stacked = np.full((len(joints), int(lengths.max()), *joints[0].shape[1:]), filler, np.float32)
    for row, clip in zip(stacked, joints, strict=True):
        row[: len(clip)] = clip
    return torch.from_numpy(stacked), lengths


@pytest.mark.parametrize("skeleton", [HUMANML3D, KIT], ids=lambda s: s.name)
def test_they_are_those_of_the_feature_extraction_whatever_else_is_in_the_batch(wander, skeleton):
    clips = [wander(skeleton, frames, seed=frames, turn=0.03) for frames in (120, 61, 9, 2)]
    rows = essential_rows(*batch(clips), skeleton)
    assert rows.shape == (4, 120, skeleton.essential_width)
    scale = np.ones(skeleton.essential_width)
    scale[1:] = skeleton.meters
    for found, clip in zip(rows.numpy(), clips, strict=True):
        wanted = extract(clip, skeleton, canonical=False)[:, : skeleton.essential_width]
        size = len(clip)
        np.testing.assert_allclose(scale * found[: size - 1], scale * wanted, atol=2e-5)
        np.testing.assert_array_equal(found[size - 1, :3], found[size - 2, :3])
        assert not found[size:].any()


def test_the_last_row_is_that_of_every_frame_s_extraction(wander):
    rows = extract_every(wander(HUMANML3D, 80, seed=1), HUMANML3D)[:, :67]
    joints = recover_joints(torch.from_numpy(rows)[None], HUMANML3D)
    again = essential_rows(joints, torch.tensor([80]), HUMANML3D)[0].numpy()
    np.testing.assert_allclose(again, rows, atol=2e-5)


def test_joints_come_back_and_one_frame_has_no_step(wander):
    joints = torch.from_numpy(wander(HUMANML3D, 196, seed=2, turn=0.05)).float()[None]
    joints = joints - joints[:, :1, :1] * torch.tensor([1.0, 0.0, 1.0])
    rows = essential_rows(joints, torch.tensor([196]), HUMANML3D)
    assert (recover_joints(rows, HUMANML3D) - joints).abs().max() < 1e-4
    alone = essential_rows(joints[:, :1], torch.tensor([1]), HUMANML3D)
    assert not alone[..., :3].any()
    torch.testing.assert_close(alone[..., 3:], rows[:, :1, 3:])


def test_it_can_be_trained_through_and_refuses_other_bodies(wander):
    joints = torch.from_numpy(wander(HUMANML3D, 20)).float()[None].requires_grad_()
    essential_rows(joints, torch.tensor([20]), HUMANML3D).square().sum().backward()
    assert joints.grad.isfinite().all()
    with pytest.raises(ValueError, match=r"joints have shape \(1, 20, 22, 3\).*21, 3"):
        essential_rows(joints, torch.tensor([20]), KIT)


def test_other_headings_describe_the_same_joints(wander):
    made, goal = (extract(wander(HUMANML3D, 81, seed=s, turn=t), HUMANML3D)[:, :67] for s, t in ((3, 0.04), (4, -0.02)))
    held = np.zeros(80, bool)
    held[:20] = held[60:] = True
    rows = faced(made, goal, held, HUMANML3D)
    yaw, wanted, own = (Trajectory.of(r).yaw for r in (rows, goal, made))
    np.testing.assert_allclose(np.exp(1j * yaw[held]), np.exp(1j * wanted[held]), atol=1e-5)
    assert np.abs(np.exp(1j * yaw) - np.exp(1j * own)).max() > 0.1
    joints = [recover_joints(torch.from_numpy(r), HUMANML3D) for r in (made, rows)]
    assert (joints[0] - joints[1]).norm(dim=-1).max() < 1e-4
    assert faced(made, goal, np.zeros(80, bool), HUMANML3D) is made

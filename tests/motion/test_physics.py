from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from kinema.motion.physics import (
    floor_distances,
    foot_skating,
    heading_at,
    jitter,
    turn_angle,
)
from kinema.motion.recovery import recover_root
from kinema.motion.skeleton import HUMANML3D, KIT

GENERATOR = torch.Generator().manual_seed(0)


def standing(batch, frames):
    joints = torch.ones(batch, frames, 22, 3)
    joints[:, :, [10, 11]] = 0.0
    return joints


def test_skating_is_the_share_of_low_toes_that_slide():
    joints = standing(3, 11)
    joints[1, :, 10, 0] = torch.arange(11) * 0.05  # the left toe slides at 1 m/s throughout
    joints[2, :, 10, 0] = torch.arange(11) * 0.05
    joints[2, 5:, 10, 1] = 0.2  # ... but leaves the floor after four steps
    lengths = torch.tensor([11, 11, 11])
    torch.testing.assert_close(foot_skating(joints, lengths, HUMANML3D), torch.tensor([0.0, 0.5, 4 / 14]))


def test_skating_without_contact_is_zero():
    assert foot_skating(torch.ones(1, 9, 22, 3), torch.tensor([9]), HUMANML3D).item() == 0


def test_skating_reads_the_skeletons_unit_and_rate():
    joints = torch.full((1, 11, 21, 3), 900.0)
    joints[:, :, [15, 20]] = 0.0
    joints[0, :, 20, 2] = torch.arange(11) * 50.0  # 50 mm a frame at 12.5 fps: 0.625 m/s
    assert foot_skating(joints, torch.tensor([11]), KIT).item() == 0.5
    assert foot_skating(joints, torch.tensor([11]), replace(KIT, fps=5.0)).item() == 0


def test_float_and_penetration_are_the_lowest_joints_millimetres():
    joints = standing(3, 10)  # toes at 0
    joints[0, :, :, 1] += 0.03
    joints[1, :5, 10, 1] = -0.02  # half of the time one toe is 2 cm below
    joints[2, :, [10, 11], 1] = 0.004  # within the tolerance
    joints[2, 6:] = -9  # past the end
    lengths = torch.tensor([10, 10, 6])
    floating, penetration = floor_distances(joints, lengths, HUMANML3D)
    torch.testing.assert_close(floating, torch.tensor([30.0, 0.0, 0.0]))
    torch.testing.assert_close(penetration, torch.tensor([0.0, 10.0, 0.0]))
    kit = floor_distances(1000 * joints[:, :, :21], lengths, KIT)  # millimetres
    torch.testing.assert_close(kit, (floating, penetration))


def test_float_and_penetration_are_what_a_loop_over_frames_finds():
    joints = 0.05 * torch.randn(4, 12, 22, 3, generator=torch.Generator().manual_seed(3))
    joints[..., 1] += 0.08
    lengths = torch.tensor([12, 9, 5, 1])
    expected = []
    for clip, length in zip(joints.double().numpy(), lengths.tolist(), strict=True):
        heights = [min(joint[1] for joint in frame) for frame in clip[:length]]
        heights = [0.0 if -0.005 <= h <= 0.005 else 1000 * h for h in heights]
        expected.append([sum(max(s * h, 0) for h in heights) / length for s in (1, -1)])
    found = torch.stack(floor_distances(joints, lengths, HUMANML3D), dim=1)
    torch.testing.assert_close(found, torch.tensor(expected, dtype=torch.float32))
    assert (found[:3] > 0).all()


def test_jitter_is_the_third_derivative_in_metres():
    t = torch.arange(12, dtype=torch.float64) / 20
    joints = torch.zeros(2, 12, 22, 3, dtype=torch.float64)
    joints[0, :, :, 0] = (t**3)[:, None]  # third derivative 6
    joints[1, :, :, 1] = (t**2)[:, None]
    lengths = torch.tensor([12, 12])
    expected = torch.tensor([6.0, 0.0], dtype=torch.float64)
    torch.testing.assert_close(jitter(joints, lengths, 20.0), expected)
    torch.testing.assert_close(jitter(joints * 1000, lengths, 20.0, unit="mm"), expected)
    with pytest.raises(ValueError, match="'cm'"):
        jitter(joints, lengths, 20.0, unit="cm")


def test_turn_angle_is_signed_and_counts_turns():
    features = torch.zeros(2, 20, 67)
    features[0, :, 0], features[1, :, 0] = math.pi / 8, -0.01
    lengths = torch.tensor([20, 10])
    torch.testing.assert_close(turn_angle(features, lengths), torch.tensor([5 * math.pi, -0.2]))


def test_heading_at_is_the_yaw_of_recovery():
    features = torch.randn(3, 20, 67, generator=GENERATOR)
    yaw = recover_root(features)[0]
    frames = torch.tensor([0, 7, 19])
    torch.testing.assert_close(heading_at(features, frames), yaw[torch.arange(3), frames])


@pytest.mark.parametrize("length", [1, 2, 9])
def test_padding_changes_nothing_and_short_clips_give_numbers(length):
    lengths = torch.tensor([length])
    joints = torch.randn(1, length, 22, 3, generator=GENERATOR) * 0.1
    features = torch.randn(1, length, 67, generator=GENERATOR)
    padded_joints = torch.cat([joints, torch.full((1, 5, 22, 3), torch.nan)], dim=1)
    padded_features = torch.cat([features, torch.full((1, 5, 67), torch.nan)], dim=1)
    for measure, values, padded in [
        (lambda j, n: foot_skating(j, n, HUMANML3D), joints, padded_joints),
        (lambda j, n: floor_distances(j, n, HUMANML3D)[1], joints, padded_joints),
        (lambda j, n: jitter(j, n, 20.0), joints, padded_joints),
        (turn_angle, features, padded_features),
    ]:
        alone = measure(values, lengths)
        assert torch.isfinite(alone).all()
        torch.testing.assert_close(measure(padded, lengths), alone)

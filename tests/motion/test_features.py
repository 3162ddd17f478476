from __future__ import annotations

import numpy as np
import pytest
import torch

from kinema.motion.features import canonicalise, extract, heading, to_facing
from kinema.motion.kinematics import bone_lengths, uniform_skeleton
from kinema.motion.recovery import joints_from_rotations, recover_joints
from kinema.motion.rotation import rotate_yaw, unit
from kinema.motion.skeleton import HUMANML3D, KIT, SKELETONS

BOTH = [pytest.param(s, id=s.name) for s in SKELETONS.values()]


def per_metre(features, skeleton):
    """Scale the length columns to metres, so that one tolerance fits both skeletons."""
    scale = np.ones(features.shape[-1])
    for name in ("root_linear", "root_height", "joints", "velocities"):
        scale[skeleton.groups[name]] = skeleton.meters
    return features * scale


@pytest.mark.parametrize("skeleton", BOTH)
@pytest.mark.parametrize(("seed", "turn"), [(0, 0.0), (1, 0.02), (2, -0.15), (3, 0.4)])
def test_recovery_undoes_extraction(skeleton, wander, seed, turn):
    joints = canonicalise(wander(skeleton, 50, seed, turn), skeleton)
    features = extract(joints, skeleton)
    assert features.shape == (49, skeleton.feature_width)
    assert features.dtype == np.float32
    recovered = recover_joints(torch.from_numpy(features), skeleton).numpy()
    np.testing.assert_allclose(recovered * skeleton.meters, joints[:-1] * skeleton.meters, atol=1e-5)
    own = bone_lengths(joints[0], skeleton)
    placed = joints_from_rotations(torch.from_numpy(features), skeleton, own).numpy()
    np.testing.assert_allclose(placed * skeleton.meters, joints[:-1] * skeleton.meters, atol=1e-5)


@pytest.mark.parametrize("skeleton", BOTH)
def test_extraction_ignores_where_the_clip_stands_and_faces(skeleton, wander):
    joints = wander(skeleton, 40, seed=4)
    moved = rotate_yaw(joints, 2.5) + np.array([3, -1, 2]) / skeleton.meters
    first, second = (per_metre(extract(clip, skeleton), skeleton) for clip in (joints, moved))
    np.testing.assert_allclose(first, second, atol=2e-6)


@pytest.mark.parametrize("skeleton", BOTH)
def test_a_canonical_clip_stands_on_the_floor_at_the_origin_facing_forward(skeleton, wander):
    joints = canonicalise(wander(skeleton, 30, seed=5), skeleton)
    assert joints[..., 1].min() == 0
    np.testing.assert_array_equal(joints[0, 0, [0, 2]], 0)
    right_hip, left_hip, right_shoulder, left_shoulder = joints[0, list(skeleton.face_joints)]
    across = unit(right_hip - left_hip + right_shoulder - left_shoulder)
    assert abs(across[2]) < 1e-9
    assert across[0] < 0  # the right side lies at -X


def test_a_clip_that_faces_straight_back_is_turned_not_lost(wander):
    joints = canonicalise(wander(HUMANML3D, 10, seed=6), HUMANML3D)
    np.testing.assert_allclose(to_facing(rotate_yaw(joints, np.pi), HUMANML3D), joints, atol=1e-9)


def test_the_angular_velocity_is_half_the_yaw_increment(wander):
    rate = 0.05
    still = np.repeat(wander(HUMANML3D, 1, seed=7), 260, axis=0)
    turning = rotate_yaw(still, rate * np.arange(260))
    yaw_rate = extract(turning, HUMANML3D)[:, 0]
    # A turn to the left (from +Z to +X) lowers the yaw that undoes it. Away from the smoothing's borders it is exact.
    np.testing.assert_allclose(yaw_rate[81:170], -rate / 2, atol=1e-6)


def test_the_first_heading_is_declared_zero(wander):
    still = np.repeat(wander(HUMANML3D, 1, seed=8), 6, axis=0)
    yaw = heading(canonicalise(still, HUMANML3D), HUMANML3D)
    assert yaw[0] == 0
    assert abs(yaw[1]) > 0.1  # with its hips flipped, the figure does not face +Z
    np.testing.assert_allclose(extract(still, HUMANML3D)[:, 0], [yaw[1] / 2, 0, 0, 0, 0], atol=1e-7)


def test_the_heading_takes_the_hips_with_the_wrong_sign():
    rest = np.stack([HUMANML3D.ancestry @ (HUMANML3D.rest_directions * HUMANML3D.bone_lengths[:, None])] * 3)
    twisted = rest.copy()
    twisted[:, 1:3] = rotate_yaw(rest[:, 1:3], 0.5)  # hips to the left: the heading should follow, but goes right
    assert heading(rest, HUMANML3D)[1] == pytest.approx(0, abs=0.01)
    assert heading(twisted, HUMANML3D)[1] > 0.5


@pytest.mark.parametrize("foot", range(4))
def test_contacts_name_left_ankle_left_toe_right_ankle_right_toe(wander, foot):
    joints = np.repeat(wander(HUMANML3D, 1, seed=10), 6, axis=0)
    joint = [*HUMANML3D.feet_left, *HUMANML3D.feet_right][foot]
    assert HUMANML3D.joint_names[joint] == ["left_ankle", "left_foot", "right_ankle", "right_foot"][foot]
    joints[3:, joint] += 0.06  # 0.0108 m^2 > 0.002
    expected = np.ones((5, 4))
    expected[2, foot] = 0
    np.testing.assert_array_equal(extract(joints, HUMANML3D)[:, HUMANML3D.groups["contacts"]], expected)


def test_linear_velocity_turns_with_the_next_frame_and_joint_velocity_with_its_own(wander):
    joints = canonicalise(wander(HUMANML3D, 30, seed=11, turn=0.3), HUMANML3D)
    features, yaw, step = extract(joints, HUMANML3D), heading(joints, HUMANML3D), np.diff(joints, axis=0)
    linear = rotate_yaw(step[:, 0], yaw[1:])[:, [0, 2]]
    np.testing.assert_allclose(features[:, HUMANML3D.groups["root_linear"]], linear, atol=1e-6)
    root = features[:, HUMANML3D.groups["velocities"]][:, :3]
    np.testing.assert_allclose(root, rotate_yaw(step[:, 0], yaw[:-1]), atol=1e-6)


def test_arms_turn_relative_to_the_heading_not_to_the_spine(wander):
    joints = canonicalise(wander(HUMANML3D, 20, seed=12), HUMANML3D)
    bent = joints.copy()
    bent[:, [9, 12, 13, 14, *range(15, 22)]] += (0.0, 0.05, 0.1)  # moves spine3 and all above it: only its bone turns
    changed = np.abs(extract(joints, HUMANML3D, canonical=False) - extract(bent, HUMANML3D, canonical=False))
    rotations = changed[:, HUMANML3D.groups["rotations"]].reshape(19, 21, 6).max((0, 2))
    names = {HUMANML3D.joint_names[j + 1] for j in np.flatnonzero(rotations > 1e-4)}
    assert names == {"spine3", "neck"}


@pytest.mark.parametrize("skeleton", BOTH)
def test_uniform_skeleton_replaces_lengths_and_keeps_directions(skeleton, wander):
    joints = wander(skeleton, 12, seed=13)
    own = bone_lengths(joints[0], skeleton)
    np.testing.assert_allclose(uniform_skeleton(joints, skeleton, own), joints, atol=1e-9 / skeleton.meters)
    target = own * np.random.default_rng(0).uniform(0.7, 1.4, size=own.shape)
    uniform = uniform_skeleton(joints, skeleton, target)
    np.testing.assert_allclose(bone_lengths(uniform, skeleton), np.broadcast_to(target, (12, len(target))), atol=1e-9)
    legs = list(skeleton.leg_joints)
    np.testing.assert_allclose(uniform[:, 0], joints[:, 0] * target[legs].sum() / own[legs].sum())


def test_the_skeletons_own_lengths_are_chosen_by_name(wander):
    joints = wander(HUMANML3D, 12, seed=14) * 1.3
    features = torch.from_numpy(extract(joints, HUMANML3D, target_bone_lengths="skeleton"))
    lengths = bone_lengths(recover_joints(features, HUMANML3D).numpy(), HUMANML3D)
    np.testing.assert_allclose(lengths, np.broadcast_to(HUMANML3D.bone_lengths, lengths.shape), atol=1e-6)


def test_a_bone_opposite_to_its_rest_direction_keeps_a_rotation(wander):
    joints = np.repeat(wander(HUMANML3D, 1, seed=15), 5, axis=0)
    joints[:, 20] = joints[:, 18] + (0, 0.3, 0)  # the left forearm points straight up, its rest straight down
    features = extract(joints, HUMANML3D)
    assert np.isfinite(features).all()
    placed = joints_from_rotations(torch.from_numpy(features), HUMANML3D, bone_lengths(joints[0], HUMANML3D))
    np.testing.assert_allclose(placed, recover_joints(torch.from_numpy(features), HUMANML3D), atol=1e-5)


def test_a_figure_that_lies_on_its_side_has_features():
    upright = HUMANML3D.ancestry @ (HUMANML3D.rest_directions * HUMANML3D.bone_lengths[:, None])
    lying = upright[:, [1, 0, 2]] * (1, -1, 1)  # left to right is now straight up
    assert np.isfinite(extract(np.stack([lying] * 5), HUMANML3D)).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda j: j[:, :21], r"\(8, 21, 3\).*'humanml3d'.*22"),
        (lambda j: j[:1], r"frames >= 2"),
        (lambda j: np.where(np.arange(8)[:, None, None] == 5, np.nan, j), r"NaN.*frame 5"),
        (lambda j: np.where(np.arange(22)[None, :, None] == 7, j[:, [4]], j), r"'left_ankle' has no length in frame 0"),
    ],
)
def test_what_has_no_features_is_refused(wander, change, message):
    with pytest.raises(ValueError, match=message):
        extract(change(wander(HUMANML3D, 8)), HUMANML3D)


@pytest.mark.parametrize(
    ("skeleton", "target", "message"),
    [
        (KIT, "skeleton", r"'kit' has no published target bone lengths"),
        (HUMANML3D, "mean", r"'mean' is neither"),
        (HUMANML3D, np.ones(21), r"22 lengths"),
        (HUMANML3D, np.zeros(22), r"positive"),
    ],
)
def test_bad_bone_lengths_are_refused(wander, skeleton, target, message):
    with pytest.raises(ValueError, match=message):
        extract(wander(skeleton, 8), skeleton, target_bone_lengths=target)

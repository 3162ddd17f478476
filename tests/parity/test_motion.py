"""Compare with what the published scripts computed (golden/mardm, golden/humanml3d)."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from safetensors.numpy import load_file

from kinema.motion.features import canonicalise, extract
from kinema.motion.kinematics import bone_lengths, uniform_skeleton
from kinema.motion.recovery import joints_from_rotations, recover_joints, recover_root
from kinema.motion.rotation import rotate_yaw
from kinema.motion.skeleton import HUMANML3D, KIT
from kinema.motion.statistics import Statistics

CASES = [pytest.param("t2m", HUMANML3D, id="humanml3d"), pytest.param("kit", KIT, id="kit")]


@pytest.fixture(scope="module")
def golden(golden_file):
    return lambda name: load_file(golden_file(f"mardm/mardm_motion_{name}.safetensors"))


def close(actual, expected, skeleton, atol=1e-5):
    """Compare lengths in metres: the published scripts compute in float32, so their error grows with the unit."""
    np.testing.assert_allclose(actual * skeleton.meters, expected * skeleton.meters, rtol=1e-4, atol=atol)


def in_metres(features, skeleton):
    scale = np.ones(features.shape[-1])
    for name in ("root_linear", "root_height", "joints", "velocities"):
        scale[skeleton.groups[name]] = skeleton.meters
    return features * scale


@pytest.mark.parametrize(("name", "skeleton"), CASES)
def test_extraction(golden, name, skeleton):
    g = golden(name)
    target = bone_lengths(g["in.ref_frame0_joints"], skeleton)
    uniform = uniform_skeleton(g["in.joints"].astype(np.float64), skeleton, target)
    close(uniform, g["out.uniform_skeleton"], skeleton)
    close(canonicalise(uniform, skeleton), g["out.global_positions"], skeleton)
    features = in_metres(extract(g["in.joints"], skeleton, target_bone_lengths=target), skeleton)
    # KIT: float32 rounding of positions of 4,000 mm turns the published directions of 100 mm bones by 4e-5.
    expected = in_metres(g["out.features"], skeleton)
    np.testing.assert_allclose(features, expected, rtol=1e-4, atol=1e-5 if skeleton is HUMANML3D else 4e-5)


@pytest.mark.parametrize(("name", "skeleton"), CASES)
def test_features_of_the_published_positions(golden, name, skeleton):
    g = golden(name)
    features = extract(g["out.global_positions"], skeleton, canonical=False)
    np.testing.assert_allclose(
        in_metres(features, skeleton), in_metres(g["out.features"], skeleton), rtol=1e-4, atol=2e-6
    )


@pytest.mark.parametrize(("name", "skeleton"), CASES)
def test_recovery(golden, name, skeleton):
    g = golden(name)
    features = torch.from_numpy(g["out.features"].astype(np.float32))
    for joints in (
        recover_joints(features, skeleton),
        recover_joints(features[:, : skeleton.essential_width], skeleton),
    ):
        close(joints.numpy(), g["out.joints_from_ric"], skeleton)
        close(joints.numpy(), g["out.joints_from_essential"], skeleton)
    lengths = np.linalg.norm(g["in.tgt_offsets"], axis=-1)
    close(joints_from_rotations(features, skeleton, lengths).numpy(), g["out.joints_from_rot"], skeleton)
    random = recover_joints(torch.from_numpy(g["in.random_essential"]), skeleton)
    np.testing.assert_allclose(random.numpy(), g["out.random_joints"], rtol=1e-4, atol=1e-5)
    yaw, position = recover_root(features)
    close(position.numpy(), g["out.root_pos"], skeleton)
    np.testing.assert_allclose((yaw / 2).cos().numpy(), g["out.root_quat"][:, 0], atol=1e-6)
    np.testing.assert_allclose((yaw / 2).sin().numpy(), g["out.root_quat"][:, 2], atol=1e-6)


@pytest.mark.parametrize(("name", "skeleton"), CASES)
def test_statistics(golden, name, skeleton):
    g = golden(name)
    rows = g["out.features"][:, : skeleton.essential_width]
    statistics = Statistics.compute([rows[:20], rows[20:]], skeleton)
    np.testing.assert_allclose(statistics.mean, g["out.essential_mean"], rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(statistics.std, g["out.essential_std_grouped"], rtol=1e-4, atol=1e-5)


@pytest.fixture(scope="module")
def clip(golden_file):
    """Give the published rows and joints of clip 012314."""
    rows, joints = (golden_file(f"humanml3d/{kind}-012314.npy") for kind in ("new_joint_vecs", "new_joints"))
    return np.load(rows), np.load(joints)


@pytest.mark.shared
def test_recovery_of_the_published_clip(clip):
    rows, joints = clip
    recovered = recover_joints(torch.from_numpy(rows), HUMANML3D).numpy()
    np.testing.assert_allclose(recovered, joints, rtol=0, atol=1e-6)
    placed = joints_from_rotations(torch.from_numpy(rows), HUMANML3D).numpy()
    np.testing.assert_allclose(placed, joints, rtol=0, atol=1e-5)


@pytest.mark.shared
@pytest.mark.parametrize("canonical", [False, True])
def test_extraction_of_the_published_clip(clip, canonical):
    rows, joints = clip
    # The file lacks the source's last frame, which the last row's joint velocities lead to (HUMANML3D_DATA §5).
    yaw = recover_root(torch.from_numpy(rows))[0][-1].item()
    step = rotate_yaw(rows[-1:, HUMANML3D.groups["velocities"]].reshape(1, 22, 3), -yaw)
    source = np.concatenate([joints, joints[-1:] + step])
    np.testing.assert_allclose(extract(source, HUMANML3D, canonical=canonical), rows, rtol=0, atol=2e-5)


@pytest.mark.shared
def test_the_published_clip_has_the_target_skeleton(clip):
    _, joints = clip
    uniform = uniform_skeleton(joints.astype(np.float64), HUMANML3D, HUMANML3D.bone_lengths)
    np.testing.assert_allclose(uniform, joints, rtol=0, atol=1e-5)


@pytest.mark.shared
def test_the_published_deviation_is_one_number_per_group(golden_file):
    published = Statistics.load(golden_file("humanml3d/Mean.npy").parent)
    expected = [0.012826, 0.016927, 0.153766, 0.122244, 0.299692, 0.019470, 0.355933]
    for columns, value in zip(HUMANML3D.groups.values(), expected, strict=True):
        np.testing.assert_allclose(published.std[columns], value, atol=1e-6)

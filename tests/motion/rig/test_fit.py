"""Rotations are fitted to positions: near, without flips, at rest in the T-pose."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinema.data.synthetic import synthetic_catalog
from kinema.motion.captures.bvh import read_bvh
from kinema.motion.captures.capture import Capture
from kinema.motion.formats.bvh import bvh_text
from kinema.motion.kinematics import place_joints
from kinema.motion.rig.euler import continuous_euler
from kinema.motion.rig.fit import fit_rig
from kinema.motion.rig.pose import HUMANML3D_REST, rest_pose
from kinema.motion.rotation import rotate_yaw
from kinema.motion.skeleton import HUMANML3D, KIT

OFFSETS = HUMANML3D_REST.directions * HUMANML3D.bone_lengths[:, None]
T_POSE = place_joints(np.zeros(3), OFFSETS, HUMANML3D)
JOINT = {name: i for i, name in enumerate(HUMANML3D.joint_names)}


def posed(**turns: np.ndarray) -> np.ndarray:
    """Pose the T-posed body: rotation vectors (T, 3) in degrees by joint."""
    frames = len(next(iter(turns.values())))
    local = np.tile(np.eye(3), (frames, 22, 1, 1))
    for name, degrees in turns.items():
        local[:, JOINT[name]] = Rotation.from_rotvec(degrees, degrees=True).as_matrix()
    moved = np.tile(OFFSETS, (frames, 1, 1))
    return Capture(HUMANML3D.joint_names, HUMANML3D.parents, local, moved, OFFSETS, 20).positions


def steps(capture: Capture) -> np.ndarray:
    """Measure by how many degrees each joint turns from frame to frame."""
    turns = np.swapaxes(capture.rotations[:-1], -1, -2) @ capture.rotations[1:]
    return np.degrees(np.arccos(np.clip((np.trace(turns, axis1=-2, axis2=-1) - 1) / 2, -1, 1)))


def test_one_frame_is_fitted_as_the_same_one_held():
    pose = posed(left_elbow=np.array([[0.0, 40, 0]]), right_knee=np.array([[50.0, 0, 0]]))
    alone, held = (fit_rig(np.repeat(pose, n, axis=0), HUMANML3D_REST, 20) for n in (1, 5))
    np.testing.assert_allclose(alone.rotations[0], held.rotations[2], atol=1e-6)


def test_the_t_pose_needs_no_turns():
    fitted = fit_rig(np.tile(T_POSE, (3, 1, 1)), HUMANML3D_REST, 20)
    np.testing.assert_allclose(fitted.rotations, np.tile(np.eye(3), (3, 22, 1, 1)), atol=1e-8)
    assert fitted.rest_positions[:, 1].min() == pytest.approx(0)


RAMP = np.linspace(0, 1, 41)[:, None]


@pytest.mark.parametrize(
    ("joint", "way"),
    {
        "left_elbow": [0, -140, 0],
        "right_elbow": [0, 140, 0],
        "left_knee": [140, 0, 0],
        "left_hip": [-110, 0, 0],
        "left_shoulder": [0, 0, -85],
        "right_shoulder": [0, 110, 0],
        "spine1": [40, 0, 0],
        "neck": [30, 0, 0],
    }.items(),
)
def test_a_bent_joint_is_found_as_it_was_bent(joint, way):
    fitted = fit_rig(posed(**{joint: RAMP * way}), HUMANML3D_REST, 20)
    found = Rotation.from_matrix(fitted.rotations[-1, JOINT[joint]])
    # A straight limb doesn't show its twist.
    left = found * Rotation.from_rotvec(way, degrees=True).inv()
    assert np.degrees(left.magnitude()) < (15 if "shoulder" in joint or "hip" in joint else 3)


@pytest.mark.parametrize(
    ("shoulder", "elbow"), [([0, 0, -80], [0, -100, 0]), ([60, 0, 0], [0, -90, 0]), ([0, -60, 20], [0, -110, 0])]
)
def test_an_elbow_stays_a_hinge_whatever_the_shoulder_does(shoulder, elbow):
    fitted = fit_rig(posed(left_shoulder=RAMP * shoulder, left_elbow=RAMP * elbow), HUMANML3D_REST, 20)
    bends = Rotation.from_matrix(fitted.rotations[-10:, JOINT["left_elbow"]]).as_rotvec()
    np.testing.assert_allclose(bends[:, [0, 2]], 0, atol=0.1)


def test_a_body_that_turns_round_and_round_never_flips():
    yaw = np.linspace(0, 4 * np.pi, 81)
    turning = rotate_yaw(np.tile(T_POSE, (81, 1, 1)), yaw)
    fitted = fit_rig(turning, HUMANML3D_REST, 20)
    np.testing.assert_allclose(steps(fitted)[:, 0], 9, atol=1e-6)
    np.testing.assert_allclose(steps(fitted)[:, 1:], 0, atol=1e-4)
    angles = continuous_euler(fitted.rotations)[:, 0]
    np.testing.assert_allclose(angles[:, 2], np.degrees(yaw), atol=1e-4)


@pytest.fixture(scope="module")
def clips():
    return [clip.joints() for clip in synthetic_catalog(size=40, seed=3, skeleton="humanml3d")][:20]


def test_positions_are_reproduced_within_a_centimetre_and_bones_keep_their_lengths(clips):
    errors = []
    for joints in clips:
        fitted = fit_rig(joints, HUMANML3D_REST, 20)
        errors.append(np.linalg.norm(fitted.positions - joints, axis=-1).mean())
        assert np.ptp(np.linalg.norm(fitted.translations[:, 1:], axis=-1), axis=0).max() == 0
        assert np.linalg.det(fitted.rotations) == pytest.approx(1)
    assert np.mean(errors) < 0.01


def test_a_motion_moved_and_turned_is_fitted_alike(clips):
    fitted = fit_rig(clips[0], HUMANML3D_REST, 20)
    other = fit_rig(rotate_yaw(clips[0], 1.2) + np.array([3, 0, -2]), HUMANML3D_REST, 20)
    np.testing.assert_allclose(other.rotations[:, 1:], fitted.rotations[:, 1:], atol=1e-7)


def test_a_written_bvh_holds_the_fitted_positions_in_centimetres(clips, tmp_path):
    fitted = fit_rig(clips[0], HUMANML3D_REST, 20)
    (tmp_path / "a.bvh").write_text(bvh_text(fitted))
    read = read_bvh(tmp_path / "a.bvh")
    assert read.names[:2] == ("Hips", "LeftUpLeg")
    names = [n for n in read.names if not n.endswith("_end")]
    order = [HUMANML3D.joint_names[i] for i in HUMANML3D_REST.order]
    assert len(names) == len(order)
    wanted = dict(zip(map(_mixamo, HUMANML3D.joint_names), range(22), strict=True))
    found = read.positions[:, [read.names.index(name) for name in wanted]] / 100
    np.testing.assert_allclose(found, fitted.positions, atol=1e-4)


def _mixamo(name: str) -> str:
    from kinema.motion.captures.mapping import known_mappings

    return next(iter(known_mappings()["mixamo"].joints[name]))


def test_a_skeleton_without_a_t_pose_is_refused():
    with pytest.raises(ValueError, match="no T-pose of kit"):
        rest_pose(KIT)

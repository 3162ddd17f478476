"""AMASS' layout: rotations give the fitted joints back, by plain NumPy and SciPy and by our own reader."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinema.data.captures import read_captures
from kinema.data.synthetic import synthetic_catalog
from kinema.motion import export
from kinema.motion.captures.amass import BodyModels, read_amass
from kinema.motion.kinematics import bone_vectors
from kinema.motion.recording import read_recording
from kinema.motion.rig.changes import Changes
from kinema.motion.rig.fit import fit_rig
from kinema.motion.rig.pose import HUMANML3D_REST, SMPL_REST, smpl_rest_pose
from kinema.motion.rotation import unit
from kinema.motion.skeleton import HUMANML3D, KIT
from kinema.types import Motion

PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19)
"""SMPL's, written out: this file reads as somebody else would."""
LIMBS = ("left_knee", "right_knee", "left_ankle", "right_ankle", "left_elbow", "right_elbow", "left_wrist")


def posed(rest: np.ndarray, poses: np.ndarray, trans: np.ndarray) -> np.ndarray:
    """Pose a body's joints (22, 3) as SMPL does: (T, 22, 3)."""
    turned, placed = [], []
    for joint, parent in enumerate(PARENTS):
        own = Rotation.from_rotvec(poses[:, 3 * joint : 3 * joint + 3])
        turned.append(own if parent < 0 else turned[parent] * own)
        way = trans + rest[0] if parent < 0 else placed[parent] + turned[parent].apply(rest[joint] - rest[parent])
        placed.append(way)
    return np.stack(placed, 1)


def motions() -> list[Motion]:
    clips = list(synthetic_catalog(size=12, seed=1))[:4]
    return [Motion(c.joints().astype(np.float32), np.zeros((0, 0)), "walks", "humanml3d", 20.0) for c in clips]


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("amass")
    return [(m, export.save(m, folder / f"{i}.amass.npz")) for i, m in enumerate(motions())]


def test_the_rotations_give_the_fitted_joints_back(written):
    for motion, path in written:
        with np.load(path) as file:
            found = posed(file["rest_joints"], file["poses"], file["trans"])
        y_up = np.stack([found[..., 0], found[..., 2], -found[..., 1]], -1)
        fitted = fit_rig(motion.joints, SMPL_REST, 20).positions
        np.testing.assert_allclose(y_up, fitted, atol=1e-6)
        assert np.linalg.norm(y_up - motion.joints, axis=-1).mean() < 0.01
        assert np.ptp(found[0, :, 2]) > 1.2  # it stands along Z


def test_the_layout_is_that_of_amass(written):
    _, path = written[0]
    with np.load(path) as file:
        frames = len(file["trans"])
        shapes = {"poses": (frames, 156), "trans": (frames, 3), "betas": (16,), "dmpls": (frames, 8)}
        assert {name: file[name].shape for name in shapes} == shapes
        assert not file["poses"][:, 66:].any()
        assert not file["betas"].any()
        assert (str(file["gender"]), float(file["mocap_framerate"]), str(file["up_axis"])) == ("neutral", 20, "z")
        assert "Z up" in str(file["about"])


def test_our_own_reader_reads_it_with_a_body_of_these_bones(written, tmp_path):
    for motion, path in written:
        with np.load(path) as file:
            rest = file["rest_joints"]
        for gender in ("male", "female"):
            (tmp_path / gender).mkdir(exist_ok=True)
            body = {"J_regressor": np.eye(22), "v_template": rest, "shapedirs": np.zeros((22, 3, 16))}
            np.savez(tmp_path / gender / "model.npz", **body)
        read = read_amass(path, BodyModels(tmp_path))
        x, y, z = np.moveaxis(read.positions, -1, 0)
        np.testing.assert_allclose(np.stack([x, z, -y], -1), fit_rig(motion.joints, SMPL_REST, 20).positions, atol=1e-6)
        assert read.fps == 20


def test_it_is_read_back_without_a_body_model(written, tmp_path):
    """In its own bones, upright although the body lies: the file says which axis is up."""
    turned = replace(motions()[0], joints=motions()[0].joints[..., [0, 2, 1]] * np.float32([1, -1, 1]))
    for motion, path in (*written, (turned, export.save(turned, tmp_path / "lying.amass.npz"))):
        recording = read_recording(path)
        fitted = fit_rig(motion.joints, SMPL_REST, 20).positions
        assert np.abs(recording.joints - fitted).max() < 1e-4
        assert recording.note.startswith("SMPL, 20 fps, z up, guessed scale 1: a body of ")
    fast = export.save(written[0][0], tmp_path / "a.amass.npz", Changes(fps=60))
    np.testing.assert_allclose(read_recording(fast).joints, read_recording(written[0][1]).joints, atol=1e-4)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rest_joints": np.zeros((21, 3))}, r"rest_joints has shape \(21, 3\), allowed: \(22, 3\)"),
        ({"rest_joints": np.full((22, 3), np.nan)}, "infinite rest_joints"),
        ({"up_axis": np.array("up")}, "says up_axis='up'; allowed: x, y, z"),
        ({"rest_joints": np.array([print] * 22, dtype=object)}, "Python objects"),
        ({"rest_joints": None}, "holds parameters of an SMPL body"),
    ],
)
def test_what_is_wrong_with_its_own_keys_is_said(changes, message, written, tmp_path):
    with np.load(written[0][1]) as file:
        content = {name: value for name, value in (dict(file) | changes).items() if value is not None}
    np.savez(tmp_path / "bad.amass.npz", **content)
    with pytest.raises(ValueError, match=message):
        read_recording(tmp_path / "bad.amass.npz")


def test_a_corpus_is_prepared_of_it_without_a_body_model(written, tmp_path):
    catalog = read_captures(written[0][1].parent, format="amass")
    assert len(catalog.dropped) == 0
    first = next(clip for clip in catalog if clip.name == "0.amass")
    fitted = fit_rig(written[0][0].joints, SMPL_REST, 20).positions
    np.testing.assert_allclose(first.joints(), fitted, atol=1e-4)


def test_the_mean_body_moves_the_way_the_motion_does(written):
    """A body of other bones, at rest as SMPL is: bones point where the motion's do, to some degrees."""
    lengths = HUMANML3D.bone_lengths
    rest = HUMANML3D.ancestry @ (SMPL_REST.directions * lengths[:, None])
    for motion, path in written:
        with np.load(path) as file:
            x, y, z = np.moveaxis(posed(rest, file["poses"], file["trans"]), -1, 0)
        seen = unit(bone_vectors(np.stack([x, z, -y], -1), HUMANML3D))
        meant = unit(bone_vectors(motion.joints.astype(np.float64), HUMANML3D))
        cosine = np.einsum("tji,tji->tj", seen, meant)[:, 1:]
        angles = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
        limbs = [HUMANML3D.joint_names.index(name) - 1 for name in LIMBS]
        assert angles.mean() < 4
        assert angles[:, limbs].mean() < 1


def test_it_may_be_faster_and_has_its_own_axes(written, tmp_path):
    motion, path = written[0]
    fast = export.save(motion, tmp_path / "a.amass.npz", Changes(fps=30))
    with np.load(path) as slow, np.load(fast) as file:
        assert float(file["mocap_framerate"]) == 30
        np.testing.assert_allclose(file["trans"][::3], slow["trans"][::2][: len(file["trans"][::3])], atol=1e-9)
    with pytest.raises(ValueError, match=r"up axis and unit of \.amass\.npz are set.*options of \.bvh"):
        export.save(motion, tmp_path / "b.amass.npz", Changes(z_up=True))
    with pytest.raises(ValueError, match="no T-pose of kit"):
        smpl_rest_pose(KIT)
    assert not (tmp_path / "b.amass.npz").exists()


def test_the_rest_poses_differ_by_what_bodies_do():
    cosine = np.einsum("ji,ji->j", SMPL_REST.directions, HUMANML3D_REST.directions)[1:]
    assert np.degrees(np.arccos(cosine)).max() < 45
    left, right = np.array(HUMANML3D.mirror_pairs).T
    np.testing.assert_array_equal(SMPL_REST.directions[left], SMPL_REST.directions[right] * [-1, 1, 1])

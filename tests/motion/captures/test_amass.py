"""AMASS: joints of the user's own body model, posed; what is missing is said."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.motion.captures.conftest import archive

from kinema.motion.captures.amass import BodyModels, read_amass, read_body_model, strided
from kinema.motion.captures.reading import captured_joints
from kinema.motion.skeleton import HUMANML3D


def expected(content, models, gender):
    """Place and pose the joints, one by one."""
    with np.load(models.folder / gender / "model.npz") as body, np.load(models.soft / gender / "model.npz") as soft:
        found = []
        for t in range(len(content["poses"])):
            shaped = (
                body["v_template"]
                + body["shapedirs"][..., :10] @ content["betas"][:10]
                + soft["eigvec"][..., :8] @ content["dmpls"][t]
            )
            joints, turned, placed = (body["J_regressor"] @ shaped)[:22], [], []
            for j, parent in enumerate(HUMANML3D.parents):
                own = Rotation.from_rotvec(content["poses"][t, 3 * j : 3 * j + 3])
                turned.append(own if parent < 0 else turned[parent] * own)
                placed.append(
                    joints[0] + content["trans"][t]
                    if parent < 0
                    else placed[parent] + turned[parent].apply(joints[j] - joints[parent])
                )
            found.append(placed)
    return np.array(found)


@pytest.mark.parametrize(
    ("told", "gender"), [("male", "male"), ("female", "female"), ("neutral", "female"), (b"male", "male")]
)
def test_joints_are_those_of_the_shaped_and_posed_body(told, gender, models, tmp_path):
    content, path = archive(tmp_path / "a_poses.npz", gender=np.array(told))
    capture = read_amass(path, models)
    np.testing.assert_allclose(capture.positions, expected(content, models, gender), atol=1e-9)
    assert capture.fps == 120


def test_a_body_without_soft_tissue_or_shape_is_stiff(models, tmp_path):
    content, path = archive(tmp_path / "a.npz", betas=None, dmpls=None)
    content |= {"betas": np.zeros(16), "dmpls": np.zeros((7, 8))}
    np.testing.assert_allclose(read_amass(path, models).positions, expected(content, models, "male"), atol=1e-9)
    stiff = BodyModels(models.folder)
    np.testing.assert_allclose(read_amass(path, stiff).positions, expected(content, models, "male"), atol=1e-9)


def test_a_standing_body_is_upright_metres_by_its_joints(models, tmp_path):
    stand = np.zeros((12, 156))
    stand[:, 0] = np.pi / 2  # AMASS: Z up
    _, path = archive(tmp_path / "a.npz", 12, poses=stand, trans=np.zeros((12, 3)), betas=np.zeros(16), dmpls=None)
    joints, understood = captured_joints(read_amass(path, models), path)
    assert (understood.up, understood.scale, understood.mapping) == ("z", 1, "SMPL")
    assert joints[0, 15, 1] > joints[0, 0, 1] > joints[0, 7, 1]


@pytest.mark.parametrize(("rate", "step"), [(120, 6), (100, 5), (60, 3), (250, 12), (20, 1)])
def test_frames_are_taken_by_whole_strides(rate, step, models, tmp_path):
    _, path = archive(tmp_path / "a.npz", 40, mocap_framerate=np.array(float(rate)))
    capture = read_amass(path, models)
    np.testing.assert_array_equal(strided(capture, 20).translations, capture.translations[::step])
    assert strided(capture, 20).fps == 20


BROKEN = {
    "no poses": ({"poses": None}, "holds no poses"),
    "no rate": ({"mocap_framerate": None}, "no frame rate"),
    "a rate of zero": ({"mocap_framerate": np.array(0.0)}, "from 1 to 1000"),
    "few columns": ({"poses": np.zeros((7, 60))}, r"poses \(7, 60\)"),
    "another length": ({"trans": np.zeros((6, 3))}, r"trans \(6, 3\)"),
    "NaN": ({"trans": np.full((7, 3), np.nan)}, "infinite trans"),
    "no frames": ({"poses": np.zeros((0, 156)), "trans": np.zeros((0, 3))}, r"poses \(0, 156\)"),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_what_is_wrong_with_an_archive_is_one_clear_error(kind, models, tmp_path):
    changes, message = BROKEN[kind]
    _, path = archive(tmp_path / "bad.npz", **changes)
    with pytest.raises(ValueError, match=message) as caught:
        read_amass(path, models)
    assert str(path) in str(caught.value)


def test_other_files_and_missing_models_are_said_plainly(models, tmp_path):
    (tmp_path / "text.npz").write_text("no archive")
    with pytest.raises(ValueError, match="give an AMASS archive"):
        read_amass(tmp_path / "text.npz", models)
    np.savez(tmp_path / "evil.npz", poses=np.array([print], dtype=object), trans=np.zeros((1, 3)))
    with pytest.raises(ValueError, match="give an AMASS archive"):
        read_amass(tmp_path / "evil.npz", models)
    _, path = archive(tmp_path / "a.npz")
    with pytest.raises(FileNotFoundError, match=r"AMASS needs the body models: .*female/model\.npz|male/model\.npz"):
        read_amass(path, BodyModels(tmp_path / "nowhere"))
    np.savez(
        tmp_path / "odd.npz", J_regressor=np.zeros((52, 9)), v_template=np.zeros((8, 3)), shapedirs=np.zeros((8, 3, 10))
    )
    with pytest.raises(ValueError, match="don't fit each other"):
        read_body_model(tmp_path / "odd.npz")

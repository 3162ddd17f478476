"""One file of motion: what this field writes is read, anything else is one line that names the file and what to do."""

from __future__ import annotations

import zipfile

import numpy as np
import pytest
import torch

from kinema.data.synthetic import synthetic_clips
from kinema.motion.convention import Convention
from kinema.motion.export import save
from kinema.motion.features import extract
from kinema.motion.recording import read_recording
from kinema.motion.recovery import recover_joints
from kinema.motion.skeleton import HUMANML3D, KIT, SKELETONS
from kinema.types import Motion


@pytest.fixture(scope="module")
def joints() -> np.ndarray:
    return next(iter(synthetic_clips(size=1, seed=3))).joints()[:61].astype(np.float32)


@pytest.mark.parametrize("hands", [2, 30, 33, 105])
def test_bodies_of_smpl_give_their_first_joints(joints, hands, tmp_path):
    np.save(tmp_path / "smpl.npy", np.concatenate([joints, np.repeat(joints[:, 20:21], hands, axis=1)], axis=1))
    found = read_recording(tmp_path / "smpl.npy")
    np.testing.assert_array_equal(found.joints, joints)
    assert "the first 22 are read" in found.note
    assert found.problems() == []


@pytest.mark.parametrize("skeleton", SKELETONS.values(), ids=SKELETONS)
@pytest.mark.parametrize("dims", ["redundant", "essential"])
@pytest.mark.parametrize("suffix", [".npy", ".npz"])
def test_features_are_recognised(skeleton, dims, suffix, tmp_path):
    clip = next(iter(synthetic_clips(size=1, seed=3, skeleton=skeleton.name))).joints()
    rows = extract(clip, skeleton)[:, : skeleton.width_of(dims)]
    file = tmp_path / f"000000{suffix}"
    np.save(file, rows) if suffix == ".npy" else np.savez(file, motion=rows, length=len(rows))
    found = read_recording(file)
    assert found.skeleton is skeleton
    np.testing.assert_array_equal(found.features, rows)
    np.testing.assert_array_equal(found.joints, recover_joints(torch.from_numpy(rows), skeleton).numpy())
    motion = found.motion(skeleton, skeleton.feature_width)
    assert motion.features.shape == (len(rows), skeleton.feature_width)
    with pytest.raises(ValueError, match="is needed"):
        found.motion(KIT if skeleton is HUMANML3D else HUMANML3D, 67)


def test_a_motion_of_ours_is_read_whole(joints, tmp_path):
    rows = extract(joints, HUMANML3D)
    file = save(Motion(joints[:-1], rows, "a person walks", "humanml3d", 20.0), tmp_path / "walk.npz")
    found = read_recording(file)
    assert found.text == "a person walks"
    np.testing.assert_array_equal(found.joints, joints[:-1])
    np.testing.assert_array_equal(found.motion(HUMANML3D, 263).features, rows)
    with pytest.raises(ValueError, match="no option changes its convention"):
        read_recording(file, Convention(up="z"))


def test_what_was_generated_keeps_its_seed_and_an_edit_its_kept_frames(joints, tmp_path):
    rows, kept = extract(joints, HUMANML3D), np.arange(len(joints) - 1) < 9
    file = save(Motion(joints[:-1], rows, "a person walks", "humanml3d", 20.0, 7, kept), tmp_path / "walk.npz")
    found = read_recording(file).motion(HUMANML3D, 67)
    assert found.seed == 7
    np.testing.assert_array_equal(found.kept, kept)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"features": slice(9)}, "parts of several motions .frames: joints 19, features 9, kept 19"),
        ({"joints": slice(5)}, "parts of several motions"),
        ({"kept": slice(3)}, "parts of several motions"),
        ({"fps": 30.0}, "fps=30, and humanml3d's motion has 20: save its joints alone"),
        ({"fps": float("nan")}, "fps=nan"),
        ({"skeleton": "smplx"}, "smplx"),
    ],
)
def test_a_motion_of_ours_whose_parts_disagree_is_refused(joints, tmp_path, change, told):
    joints = joints[:20]
    parts = {"joints": joints[:-1], "features": extract(joints, HUMANML3D), "kept": np.ones(19, bool)}
    parts |= {"text": np.array("a"), "fps": np.array(20.0), "skeleton": np.array("humanml3d")}
    for name, value in change.items():
        parts[name] = parts[name][value] if isinstance(value, slice) else np.array(value)
    np.savez(tmp_path / "walk.npz", **parts)
    with pytest.raises(ValueError, match=told):
        read_recording(tmp_path / "walk.npz")


@pytest.mark.parametrize("rate", [0.0, -20.0, float("nan"), float("inf")])
def test_a_rate_that_is_none_is_told_with_its_file(joints, rate, tmp_path):
    np.savez(tmp_path / "clip.npz", joints=joints, fps=np.array(rate))
    with pytest.raises(ValueError, match=r"clip\.npz: fps=.*; it must be a positive number; give --fps"):
        read_recording(tmp_path / "clip.npz")
    assert len(read_recording(tmp_path / "clip.npz", Convention(fps=20)).joints) == len(joints)


@pytest.mark.parametrize("told", [{"up": "z"}, {"up": "-y"}, {"handed": "left"}, {"order": "limbs"}])
def test_whole_numbers_are_turned_as_others(joints, told, tmp_path):
    whole = np.round((joints + 10) * 1000)
    read = []
    for dtype in ("uint16", "float32"):
        np.save(tmp_path / f"{dtype}.npy", whole.astype(dtype))
        read.append(read_recording(tmp_path / f"{dtype}.npy", Convention(scale=0.001, **told)).joints)
    np.testing.assert_allclose(read[0], read[1], atol=1e-5)


@pytest.mark.parametrize("name", ["fps", "mocap_framerate", "mocap_frame_rate"])
def test_an_archive_of_joints_tells_its_rate(joints, name, tmp_path):
    fast = np.repeat(joints, 3, axis=0)
    np.savez(tmp_path / "clip.npz", joints=fast, **{name: np.array(60.0)})
    np.testing.assert_array_equal(read_recording(tmp_path / "clip.npz").joints, joints)
    asked = read_recording(tmp_path / "clip.npz", Convention(fps=20))
    np.testing.assert_array_equal(asked.joints, fast)


@pytest.mark.parametrize(
    "arrays",
    [
        {"poses": np.zeros((90, 156)), "trans": np.zeros((90, 3)), "mocap_framerate": np.array(120.0)},
        {"poses": np.zeros((90, 72)), "trans": np.zeros((90, 3)), "gender": np.array(b"male")},
        {"root_orient": np.zeros((9, 3)), "pose_body": np.zeros((9, 63)), "gender": np.array({}, dtype=object)},
        {"body_pose": np.zeros((9, 69)), "global_orient": np.zeros((9, 3)), "fps": np.array([30])},
    ],
)
def test_parameters_of_a_body_model_are_told_what_they_need(arrays, tmp_path):
    np.savez(tmp_path / "amass.npz", **arrays)
    with pytest.raises(
        ValueError, match=r"amass\.npz holds parameters of an SMPL body .* save joints\[:, :22\]"
    ) as told:
        read_recording(tmp_path / "amass.npz")
    assert ("--fps 120" in str(told.value)) == ("mocap_framerate" in arrays)
    assert ("--fps 30" in str(told.value)) == ("fps" in arrays)


SHAPES = [
    ((22, 3), r"single frame.*joints\[None\]"),
    ((21, 3), r"single frame"),
    ((60, 66), r"flat joints.*reshape\(-1, 22, 3\)"),
    ((60, 63), r"flat joints.*reshape\(-1, 21, 3\)"),
    ((4, 60, 22, 3), r"batch of 4 clips"),
    ((1, 60, 21, 3), r"batch of 1 clips"),
    ((4, 22, 3, 60), r"time last.*transpose\(2, 0, 1\)"),
    ((22, 3, 60), r"time comes last"),
    ((60, 3, 22), r"joints come last"),
    ((60, 17, 3), r"body of 17 joints"),
    ((60, 22, 4), r"no motion"),
    ((60, 272), r"60 rows of 272"),
    ((60, 156), r"60 rows of 156"),
    ((60,), r"no motion"),
    ((), r"no motion"),
    ((2, 2, 60, 22, 3), r"no motion"),
]


@pytest.mark.parametrize(("shape", "words"), SHAPES, ids=[str(s) for s, _ in SHAPES])
def test_a_shape_that_is_none_is_told_what_it_is(shape, words, tmp_path):
    np.save(tmp_path / "odd.npy", np.zeros(shape, np.float32))
    with pytest.raises(ValueError, match=rf"odd\.npy holds float32 .*{words}.*humanml3d needs \(frames, 22, 3\)"):
        read_recording(tmp_path / "odd.npy")


@pytest.mark.parametrize("dtype", ["complex64", "bool", "U3", "S3", "M8[s]"])
def test_what_is_not_numbers_is_refused(dtype, tmp_path):
    np.save(tmp_path / "odd.npy", np.zeros((60, 22, 3), dtype))
    with pytest.raises(ValueError, match=r"odd\.npy holds"):
        read_recording(tmp_path / "odd.npy")


FILES = {
    "empty": b"",
    "pointer": b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 45008\n",
    "page": b"<!DOCTYPE html><html><title>Google Drive - Quota exceeded</title></html>",
    "bvh": b"HIERARCHY\nROOT Hips\n{\nOFFSET 0 0 0\n}\nMOTION\nFrames: 0\n",
    "text": b"0.1 0.2 0.3\n",
    "pickle": b"\x80\x04\x95\x05\x00\x00\x00\x00\x00\x00\x00}\x94.",
    "gzip": b"\x1f\x8b\x08\x00",
    "zeros": bytes(1000),
    "half a zip": b"PK\x03\x04" + bytes(50),
    "header only": b"\x93NUMPY\x01\x00",
    "header cut": b"\x93NUMPY\x01\x00v\x00{'descr': '<f4', 'fortr",
    "apple": b"\0\5\x16\7\0\2\0\0Mac OS X        ",
}


@pytest.mark.parametrize("suffix", [".npy", ".npz"])
@pytest.mark.parametrize("kind", FILES)
def test_other_files_are_called_what_they_are(kind, suffix, tmp_path):
    file = tmp_path / f"odd{suffix}"
    file.write_bytes(FILES[kind])
    with pytest.raises(ValueError, match=r"odd\.np[yz]") as told:
        read_recording(file)
    assert "\n" not in str(told.value)
    assert "allow_pickle" not in str(told.value)
    assert "unsafe" not in str(told.value)


def test_archives_that_hold_no_one_motion_are_told_so(joints, tmp_path):
    file = tmp_path / "odd.npz"
    for arrays, words in [
        ({"a": joints, "b": joints}, r"no archive of one motion: it has a \(61, 22, 3\), b"),
        ({"weights": np.zeros((3, 3))}, r"it has weights \(3, 3\)"),
        ({}, "it has nothing"),
        ({"motion": np.array({}, dtype=object)}, "objects"),
    ]:
        np.savez(file, **arrays)
        with pytest.raises(ValueError, match=words):
            read_recording(file)
    torch.save({"state_dict": {}}, file)
    with pytest.raises(ValueError, match="a file of torch"):
        read_recording(file)
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("readme.txt", "text")
    with pytest.raises(ValueError, match="it has nothing"):
        read_recording(file)
    with pytest.raises(FileNotFoundError, match="gone"):
        read_recording(tmp_path / "gone.npy")


def test_foreign_joints_are_not_edited_but_mended_ones_are(joints, tmp_path):
    np.save(tmp_path / "cm.npy", joints * 100)
    with pytest.raises(ValueError, match=r"cm\.npy: the unit is not humanml3d's.*fix: --scale 0\.01"):
        read_recording(tmp_path / "cm.npy").motion(HUMANML3D, 263)
    found = read_recording(tmp_path / "cm.npy", Convention(scale=0.01)).motion(HUMANML3D, 263)
    assert found.features.shape == (61, 263)
    np.save(tmp_path / "nan.npy", np.full((50, 263), np.nan, np.float32))
    with pytest.raises(ValueError, match=r"nan\.npy: NaN or infinite values in 50 frames"):
        read_recording(tmp_path / "nan.npy").motion(HUMANML3D, 263)


def test_features_take_no_option(joints, tmp_path):
    np.save(tmp_path / "000000.npy", extract(joints, HUMANML3D))
    assert read_recording(tmp_path / "000000.npy", Convention(fps=20)).features is not None
    with pytest.raises(ValueError, match=r"000000\.npy.*no option changes them"):
        read_recording(tmp_path / "000000.npy", Convention(scale=0.01))

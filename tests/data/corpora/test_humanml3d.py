"""HumanML3D is built from AMASS by its lists: strides, lead-ins, cuts, axes, mirror images; what lacks is named."""

from __future__ import annotations

import csv

import numpy as np
import pytest
from tests.motion.captures.conftest import STANDING, archive, made_up_models

from kinema.data.catalog import read_official
from kinema.data.corpora.humanml3d import Sources, build_humanml3d
from kinema.motion.captures.amass import read_amass
from kinema.motion.features import extract
from kinema.motion.mirror import mirror_joints
from kinema.motion.skeleton import HUMANML3D

ROWS = [
    ("./pose_data/CMU/01/01_02_poses.npy", 10, 30, "000001.npy"),
    ("./pose_data/CMU/01/01_02_poses.npy", 0, 1, "000002.npy"),
    ("./pose_data/MPI_Limits/03099/lar1 _poses.npy", 5, 25, "000003.npy"),
    ("./pose_data/humanact12/humanact12/P01G01.npy", 0, 0, "000004.npy"),
    ("./pose_data/KIT/3/kick_poses.npy", 0, 50, "000005.npy"),
]
NAMES = ["000001", "000003", "000004", "000005"]


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    root = tmp_path_factory.mktemp("humanml3d")
    models = made_up_models(root)
    for name in ("CMU/01", "PosePrior/03099"):
        (root / "amass" / name).mkdir(parents=True)
    upright = np.zeros((400, 156))
    upright[:, 0] = np.pi / 2
    upright += np.random.default_rng(3).normal(size=156).cumsum() * 0.001 * np.sin(np.arange(400) / 30)[:, None]
    archive(root / "amass" / "CMU/01/01_02_poses.npz", 400, poses=upright, mocap_framerate=np.array(60.0))
    archive(root / "amass" / "PosePrior/03099/lar1__stageii.npz", 400, poses=upright, mocap_framerate=np.array(100.0))
    (root / "actions").mkdir()
    np.save(root / "actions" / "P01G01.npy", np.tile(STANDING, (45, 1, 1)) + np.linspace(0, 1, 45)[:, None, None])
    lists = root / "lists"
    (lists / "HumanML3D" / "texts").mkdir(parents=True)
    with (lists / "index.csv").open("w", newline="") as file:
        csv.writer(file).writerows([("source_path", "start_frame", "end_frame", "new_name"), *ROWS])
    for split, names in {"all": NAMES, "train": NAMES[:2], "val": NAMES[2:3], "test": NAMES[3:]}.items():
        both = [*names, *(f"M{name}" for name in names)]
        (lists / "HumanML3D" / f"{split}.txt").write_text("\n".join(both))
        for name in both:
            (lists / "HumanML3D" / "texts" / f"{name}.txt").write_text(
                "a man stands.#a/DET man/NOUN stand/VERB#0.0#0.0\n"
            )
    return Sources(root / "amass", models, root / "actions"), lists, root / "out"


@pytest.fixture(scope="module")
def report(folders):
    return build_humanml3d(*folders)


def features(folders, name):
    return np.load(folders[2] / "new_joint_vecs" / f"{name}.npy")


def turned(path, models, step):
    x, y, z = np.moveaxis(read_amass(path, models).positions[::step], -1, 0)
    return np.stack([-x, z, y], -1)


def test_a_clip_is_cut_at_twenty_frames_a_second_y_up(report, folders):
    joints = turned(folders[0].amass / "CMU/01/01_02_poses.npz", folders[0].models, 3)[10:30]
    found = features(folders, "000001")
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, extract(joints, HUMANML3D, target_bone_lengths="skeleton"), atol=1e-5)
    mirrored = extract(mirror_joints(joints, HUMANML3D), HUMANML3D, target_bone_lengths="skeleton")
    np.testing.assert_allclose(features(folders, "M000001"), mirrored, atol=1e-5)


def test_a_set_under_its_new_name_loses_its_calibration(report, folders):
    joints = turned(folders[0].amass / "PosePrior/03099/lar1__stageii.npz", folders[0].models, 5)[20:][5:25]
    expected = extract(joints, HUMANML3D, target_bone_lengths="skeleton")
    np.testing.assert_allclose(features(folders, "000003"), expected, atol=1e-5)


def test_clips_of_humanact12_are_taken_whole_as_they_are(report, folders):
    joints = np.load(folders[0].actions / "P01G01.npy")
    expected = extract(joints, HUMANML3D, target_bone_lengths="skeleton")
    np.testing.assert_allclose(features(folders, "000004"), expected, atol=1e-5)


def test_what_is_missing_is_named_and_left_out(report, folders):
    assert report.clips == 6
    assert report.missing == dict.fromkeys(["000005", "M000005"], "no file KIT/3/kick_poses.npz")
    assert "all.txt   8 names (published 29228)" in str(report)
    assert (folders[2] / "missing.txt").read_text().startswith("000005: no file KIT/3/kick_poses.npz\n")
    assert (folders[2] / "test.txt").read_text() == ""


def test_the_folder_is_one_that_prepare_reads(report, folders):
    (folders[2] / "test.txt").write_text("000004\n")
    (folders[2] / "val.txt").write_text("M000004\n")
    catalog = read_official(folders[2])
    assert len(catalog) == 6
    assert len(catalog.statistics.mean) == 263
    assert all(clip.origin is not None for clip in catalog)


def test_a_second_call_makes_only_what_is_missing(report, folders, tmp_path):
    sources, _, out = folders
    before = (out / "new_joint_vecs" / "000001.npy").stat().st_mtime_ns
    (sources.amass / "KIT/3").mkdir(parents=True)
    archive(sources.amass / "KIT/3/kick_poses.npz", 400, poses=np.zeros((400, 156)), mocap_framerate=np.array(100.0))
    again = build_humanml3d(*folders)
    assert again.whole
    assert again.clips == 8
    assert not (out / "missing.txt").exists()
    assert (out / "new_joint_vecs" / "000001.npy").stat().st_mtime_ns == before


@pytest.mark.parametrize("absent", ["index.csv", "HumanML3D/train.txt"])
def test_lists_that_are_not_there_are_asked_for(absent, folders, tmp_path):
    sources, lists, _ = folders
    held = (lists / absent).read_bytes()
    (lists / absent).unlink()
    try:
        with pytest.raises(FileNotFoundError, match=absent.rpartition("/")[2]):
            build_humanml3d(sources, lists, tmp_path / "out")
    finally:
        (lists / absent).write_bytes(held)


def test_an_empty_amass_is_refused(folders, tmp_path):
    sources, lists, _ = folders
    with pytest.raises(ValueError, match=r"holds no file of the lists, such as CMU/01/01_02_poses\.npz"):
        build_humanml3d(Sources(tmp_path, sources.models, tmp_path), lists, tmp_path / "out")

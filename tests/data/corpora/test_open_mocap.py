"""open-mocap is rebuilt from the captures at hand, to the tenth of a millimetre; what is missing is named."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
from tests.conftest import SHARED
from tests.motion.captures.conftest import AMC, ASF

from kinema.data.catalog import read_joints_folder
from kinema.data.corpora.open_mocap import OWNERS, SOURCES, read_recipe, rebuild

RAW = SHARED / "data" / "raw-mocap"
AT_HAND = {
    "bandai_dataset-1_bow_angry_001": "bvh/dataset-1_bow_angry_001.bvh",
    "bandai_dataset-1_walk_giant_001": "bvh/dataset-1_walk_giant_001.bvh",
    "bandai_dataset-1_dash_happy_001": "bvh/dataset-1_dash_happy_001.bvh",
    "bandai_dataset-2_wave-left-hand_normal_001": "bvh/dataset-2_wave-left-hand_normal_001.bvh",
    "cmu_05_01": "bvh/cmu_05_01.bvh",
    "cmu_07_04": "bvh/cmu_07_04.bvh",
    "cmu_13_11": "bvh/cmu_13_11.bvh",
    "cmu_02_01": "asf-amc/02_01.amc",
    "cmu_02_04": "asf-amc/02_04.amc",
}


def test_the_recipe_names_all_clips_their_files_and_splits():
    recipe = read_recipe()
    assert len(recipe) == 2817
    assert {clip.source for clip in recipe} == SOURCES.keys()
    splits = [
        sum(getattr(c, key) == s for c in recipe)
        for key in ("split", "compositional")
        for s in ("train", "val", "test")
    ]
    assert splits == [2236, 155, 426, 1681, 476, 660]
    by_name = {clip.name: clip for clip in recipe}
    assert by_name["cmuacrnn_indian_06_s1"].file == "indian/06.bvh"
    assert by_name["cmuacrnn_indian_06_s1"].origin.start == 180
    assert by_name["hdm05_HDM_bd_depositFloorR_001_120"].file == "hdm_bd_depositfloorr_001_120.amc"


@pytest.fixture(scope="module")
def rebuilt(tmp_path_factory):
    if not RAW.is_dir():
        pytest.skip(f"{RAW} is absent; set KINEMA_SHARED to run this test")
    folder = tmp_path_factory.mktemp("captures")
    for name, file in AT_HAND.items():
        place = folder / name.partition("_")[0] / "deep"
        place.mkdir(parents=True, exist_ok=True)
        shutil.copy(RAW / file, place / file.rpartition("/")[2].removeprefix("cmu_"))
    shutil.copy(RAW / "asf-amc/02.asf", folder / "cmu" / "deep" / "02.asf")
    out = folder / "out"
    return rebuild({owner: [folder / owner] for owner in ("bandai", "cmu")}, out), out


def test_joints_are_those_of_the_corpus(rebuilt, open_mocap):
    _, out = rebuilt
    for name in AT_HAND:
        expected, found = np.load(open_mocap / f"joints/{name}.npy"), np.load(out / f"joints/{name}.npy")
        assert found.dtype == np.float32
        np.testing.assert_allclose(found, expected, atol=2e-4)
        assert (out / f"texts/{name}.txt").read_text() == (open_mocap / f"texts/{name}.txt").read_text()


def test_what_is_there_is_a_corpus_and_what_is_missing_is_named(rebuilt):
    result, out = rebuilt
    assert not result.whole
    assert result.subset == "bandai(4)+cmu(5)"
    assert "a subset of open-mocap (bandai(4)+cmu(5))" in str(result)
    assert "licence   CC BY-NC 4.0: 4 clips" in str(result)
    assert sorted(clip.name for clip in read_joints_folder(out)) == sorted(AT_HAND)
    assert {row["name"]: row["licence"] for row in json.loads((out / "manifest.json").read_text())}[
        "cmu_05_01"
    ] == "CMU"
    missing = (out / "missing.txt").read_text().splitlines()
    assert len(missing) == len(result.missing) == 2817 - len(AT_HAND)
    assert "cmuacrnn_indian_06_s0: no file indian/06.bvh" in missing


def test_a_second_call_makes_what_was_missing_alone(tmp_path, monkeypatch):
    captures = tmp_path / "cmu"
    captures.mkdir()
    (captures / "01.asf").write_text(ASF)
    (captures / "01_01.amc").write_text(AMC)
    result = rebuild({"cmu": [captures]}, tmp_path / "out")
    assert result.made == {}
    assert "is no file of Acclaim" in result.missing["cmu_01_01_s0"]
    made = np.zeros((180, 22, 3), np.float32)
    np.save(tmp_path / "out" / "cmu_01_01_s0.npy", made)
    (tmp_path / "out" / "joints").mkdir()
    (tmp_path / "out" / "cmu_01_01_s0.npy").rename(tmp_path / "out" / "joints" / "cmu_01_01_s0.npy")
    again = rebuild({"cmu": [captures]}, tmp_path / "out")
    assert again.made == {"cmu": 1}
    assert not np.load(tmp_path / "out" / "joints" / "cmu_01_01_s0.npy").any()


def test_a_folder_without_captures_is_refused(tmp_path):
    with pytest.raises(ValueError, match="holds no capture of open-mocap"):
        rebuild({owner: [tmp_path] for owner in OWNERS}, tmp_path / "out")
    with pytest.raises(FileNotFoundError, match="absent"):
        rebuild({"cmu": [tmp_path / "absent"]}, tmp_path / "out")

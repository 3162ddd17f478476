"""Clips that need different mending are told apart, by the doctor as by prepare."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinema.data.catalog import read_joints_folder
from kinema.data.doctor import diagnose
from kinema.data.prepare import prepare
from kinema.data.synthetic import synthetic_clips, write_joints_folder

SPOILT = {
    "leave the clip out": lambda j: j[:1],
    "save joints.reshape(-1, 22, 3)": lambda j: j.reshape(len(j), 66),
    "save joints.transpose(2, 0, 1)": lambda j: j.transpose(1, 2, 0),
    "--up z": lambda j: j[..., [0, 2, 1]] * np.float32([1, -1, 1]),
    "--up -y": lambda j: j * np.float32([1, -1, -1]),
}


@pytest.fixture(scope="module")
def spoilt(tmp_path_factory) -> tuple[Path, dict[str, list[str]]]:
    """Give a joints folder of 44 clips and the names of those that a fix is for, two for each."""
    folder = write_joints_folder(synthetic_clips(size=44, seed=4), tmp_path_factory.mktemp("spoilt") / "corpus")
    files = sorted((folder / "joints").glob("*.npy"))
    found = {}
    for place, (fix, change) in enumerate(SPOILT.items()):
        chosen = files[4 * place : 4 * place + 2]
        for frames, file in enumerate(chosen, 30):
            np.save(file, change(np.load(file)[:frames]))
        found[fix] = [file.stem for file in chosen]
    return folder, found


@pytest.mark.parametrize("fix", SPOILT)
def test_the_doctor_gives_every_clip_the_fix_that_is_its_own(spoilt, fix):
    folder, expected = spoilt
    (found,) = (f for f in diagnose(folder) if f.fix.startswith(fix))
    assert list(found.items) == expected[fix]
    assert found.severity == "error"  # of its kind there are more than one in twenty
    assert found.message.startswith("2 of 44 clips: ")
    lengths_are_told = fix.startswith("save")
    assert (f"first, {expected[fix][0]}: " in found.message) is lengths_are_told


def test_prepare_tells_every_fix_whether_it_goes_on_or_not(spoilt, tmp_path, capsys):
    folder, expected = spoilt
    prepare(read_joints_folder(folder), tmp_path / "store", name="x", mirror=False, max_unusable=0.5)
    lines = [line for line in capsys.readouterr().out.splitlines() if "unusable clips" in line]
    assert len(lines) == len(SPOILT)
    for fix, (first, second) in expected.items():
        (line,) = (line for line in lines if f"fix: {fix}" in line)
        assert f"left out  2 unusable clips: {first} (" in line
        assert f"; {second} (" in line
    with pytest.raises(ValueError, match="10 of 44 clips are unusable") as error:
        prepare(read_joints_folder(folder), tmp_path / "other", name="x")
    assert all(f"fix: {fix}" in str(error.value) for fix in SPOILT)

"""What a joints folder's manifest.json says holds for the clips that it names, and what has no effect is said."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from kinema.data.catalog import read_joints_folder
from kinema.data.doctor import diagnose, format
from kinema.data.prepare import prepare
from kinema.data.synthetic import synthetic_clips, write_joints_folder
from kinema.motion.resampling import resampled


@pytest.fixture(scope="module")
def fast(tmp_path_factory) -> Path:
    """Give a joints folder of 20 clips at 60 frames per second."""
    folder = write_joints_folder(synthetic_clips(size=20, seed=2), tmp_path_factory.mktemp("fast") / "corpus")
    for file in (folder / "joints").glob("*.npy"):
        np.save(file, resampled(np.load(file), 20.0, 60.0))
    return folder


@pytest.fixture
def folder(fast, tmp_path) -> Path:
    """Give a copy that may be changed."""
    return Path(shutil.copytree(fast, tmp_path / "corpus"))


def write(folder: Path, rows: list[dict]) -> None:
    (folder / "manifest.json").write_text(json.dumps(rows))


def names(folder: Path) -> list[str]:
    return sorted(file.stem for file in (folder / "joints").glob("*.npy"))


def test_a_rate_that_is_told_of_some_clips_is_said_of_those_and_the_others_are_examined(folder):
    told, untold = names(folder)[:8], names(folder)[8:]
    write(folder, [{"name": name, "fps": 60} for name in told])
    some = "60 fps for 8 of 20 clips, as manifest.json says; that of the 12 others is taken for granted"
    catalog = read_joints_folder(folder)
    assert catalog.rate.startswith(some)
    assert {c.name for c in catalog if c.convention.fps is None} == set(untold)
    guess, source = (f for f in sorted(diagnose(folder), key=lambda f: f.severity, reverse=True) if f.kind == "rate")
    assert f"frame rate: {some}" in source.message
    assert guess.severity == "warning"
    assert "the 12 clips without a rate move as if recorded at about" in guess.message
    assert "in manifest.json if so, 20 if not" in guess.fix
    assert set(guess.items) == set(source.items) == set(untold)


def test_a_rate_that_is_told_of_all_clips_is_believed(folder):
    write(folder, [{"name": f"{name}.npy", "fps": 60} for name in names(folder)])
    (found,) = (f for f in diagnose(folder) if f.kind == "rate")
    assert found.message == "frame rate: 60 fps, as manifest.json says; entries have 20 fps"
    assert not found.items


def test_names_of_no_clip_are_said_by_prepare_and_doctor(folder, tmp_path, capsys):
    known = names(folder)
    write(folder, [{"name": name, "fps": 60} for name in known] + [{"name": "clip_0x", "fps": 60}])
    lists = [folder / f"{split}.txt" for split in ("train", "val", "test")]
    for file in lists:
        file.write_text(file.read_text().replace(f"{known[0]}\n", ""))
    store = prepare(read_joints_folder(folder), tmp_path / "store", name="x", mirror=False)
    assert "manifest  1 names in manifest.json are of no clip" in capsys.readouterr().out
    for examined in (diagnose(folder), diagnose(store, source=folder)):
        (found,) = (f for f in examined if f.kind == "names of no clip")
        assert found.severity == "warning"
        assert found.items == ("manifest.json: 'clip_0x'",)  # one that no list names is a clip all the same
        assert found.fix in format(examined)


@pytest.mark.parametrize(
    ("row", "told"),
    [
        ({"name": "a", "FPS": 60}, "number 1, with 'FPS'; write \"fps\""),
        ({"Name": "a", "fps": 60}, "number 1, with 'Name'; write \"name\""),
        ({"name": "a", "fps ": 60}, "number 1, with 'fps '; write \"fps\""),
    ],
)
def test_a_key_in_another_spelling_is_refused(folder, row, told):
    write(folder, [row])
    with pytest.raises(ValueError, match=told):
        read_joints_folder(folder)


@pytest.mark.parametrize("fps", ["fast", "nan", -60, 0, True, float("inf")])
def test_a_rate_that_is_none_is_refused(folder, fps):
    write(folder, [{"name": names(folder)[0], "fps": fps}])
    with pytest.raises(ValueError, match=r"manifest\.json: clip .* has fps .*; write a positive number"):
        read_joints_folder(folder)


def test_a_clip_has_one_row(folder):
    write(folder, [{"name": "a", "fps": 60}, {"name": "a.npy", "fps": 30}])
    with pytest.raises(ValueError, match="has clip 'a' twice, again as number 2"):
        read_joints_folder(folder)

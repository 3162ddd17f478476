"""`kinema export` writes a motion for other tools, and reads back what it wrote."""

from __future__ import annotations

import re

import numpy as np
import pytest

from kinema import cli
from kinema.data.synthetic import synthetic_catalog
from kinema.motion.captures.bvh import read_bvh
from kinema.motion.export import save
from kinema.motion.formats.arrays import load_npz


@pytest.fixture
def walk(tmp_path):
    """Write one synthetic clip's joints, lifted off the floor."""
    clip = next(iter(synthetic_catalog(size=8, seed=2)))
    np.save(tmp_path / "walk.npy", (clip.joints() + np.array([0, 0.3, 0])).astype(np.float32))
    return tmp_path / "walk.npy"


def test_what_was_exported_comes_back_whatever_its_axes_and_rate(walk, tmp_path, capsys):
    assert cli.main(["export", str(walk), "--out", str(tmp_path / "a.bvh"), "--rate", "60", "--z-up"]) == 0
    assert "mm on average" in capsys.readouterr().out
    assert cli.main(["export", str(tmp_path / "a.bvh"), "--out", str(tmp_path / "back.npz")]) == 0
    assert "Mixamo, 60 fps, z up, guessed scale 0.01" in capsys.readouterr().out
    assert cli.main(["export", str(walk), "--out", str(tmp_path / "own.npz")]) == 0
    back, own = load_npz(tmp_path / "back.npz").joints, load_npz(tmp_path / "own.npz").joints
    assert np.linalg.norm(back - own, axis=-1).mean() < 0.01


def test_a_bvh_in_metres_is_a_hundredth_of_one_in_centimetres(walk, tmp_path):
    for unit in ("cm", "m"):
        assert cli.main(["export", str(walk), "--out", str(tmp_path / f"{unit}.bvh"), "--unit", unit]) == 0
    large, small = (read_bvh(tmp_path / f"{unit}.bvh") for unit in ("cm", "m"))
    np.testing.assert_allclose(large.positions / 100, small.positions, atol=1e-4)


@pytest.mark.parametrize("suffix", [".glb", ".vrma", ".bvh", ".amass.npz", ".html"])
def test_every_format_is_written(suffix, walk, tmp_path):
    assert cli.main(["export", str(walk), "--out", str(tmp_path / f"a{suffix}")]) == 0
    assert (tmp_path / f"a{suffix}").stat().st_size > 5000


@pytest.mark.parametrize("suffix", [".glb", ".vrma", ".bvh", ".amass.npz"])
def test_no_rotation_leads_to_nan(suffix, walk, tmp_path):
    assert cli.main(["export", str(walk), "--out", str(tmp_path / "own.npz")]) == 0
    broken = load_npz(tmp_path / "own.npz")
    broken.joints[3, 5] = np.nan
    with pytest.raises(ValueError, match=r"1 of \d+ frames hold NaN or infinity"):
        save(broken, tmp_path / f"a{suffix}")
    assert not (tmp_path / f"a{suffix}").exists()


def test_held_feet_are_told_and_stand_where_the_capture_stood(walk, tmp_path, capsys):
    assert cli.main(["export", str(walk), "--out", str(tmp_path / "a.npz"), "--lock-feet"]) == 0
    assert re.search(
        r"feet +skating \d+\.\d -> \d+\.\d %, drift .* cm, jitter .* m/s3, penetration", capsys.readouterr().out
    )
    assert load_npz(tmp_path / "a.npz").joints[..., 1].min() > 0.25


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--out", "a.npz", "--loop"], "write one of these"),
        (["--out", "a.glb", "--z-up"], "up axis and unit of .glb are set by its specification"),
        (["--out", "a.vrma", "--unit", "m"], "--unit are options of .bvh"),
        (["--out", "a.doc"], "unknown suffix"),
        (["--out", "a.bvh", "--rate", "0"], "--rate=0"),
        (["--out", "a.bvh", "--rate", "0.5"], "--rate=0.5"),
        (["--out", "a.bvh", "--rate", "1e9"], "--rate=1"),
        (["--out", "a.bvh", "--rate", "nan"], "--rate=NaN"),
        (["--out", "a.bvh", "--facing", "nan"], "--facing=NaN"),
        (["--out", "a.bvh", "--mapping", "x.yaml"], "no names to map"),
    ],
)
def test_what_a_format_cannot_hold_is_one_clear_error(words, message, walk, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["export", str(walk), *words]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / words[1]).exists()

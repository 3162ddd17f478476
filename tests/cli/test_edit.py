"""`kinema edit`, and parts of motions: what is kept, where it stands, what is said of it."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cli.conftest import FAST, fails

from kinema import cli
from kinema.motion.formats.arrays import load_npz, save_npz
from kinema.motion.recording import read_recording
from kinema.motion.skeleton import HUMANML3D


def test_what_is_decoded_raw_keeps_nothing_and_held_feet_are_said(run, capsys):
    make = ["generate", "a person walks", "--run", str(run), "--seed", "3", "--frames", "40", *FAST]
    assert cli.main([*make, "--out", "walk.npz"]) == 0
    change = ["edit", "--motion", "walk.npz", "--text", "someone sits", "--run", str(run), "--keep", "0:20", *FAST]
    assert cli.main([*change, "--lock-feet", "--out", "edited.npz"]) == 0
    assert "kept frames 0:20 (but for feet that were held); largest step" in capsys.readouterr().out
    assert cli.main([*change, "--raw", "--out", "raw.npz"]) == 0
    assert "kept" not in capsys.readouterr().out
    assert load_npz("raw.npz").kept is None


def test_a_part_of_a_long_motion_is_taken(run, capsys):
    make = ["generate", "a person walks", "--run", str(run), "--seed", "3", "--chain", "--seconds", "15", *FAST]
    assert cli.main([*make, "--out", "long.npz"]) == 0
    long = load_npz("long.npz")
    change = ["edit", "--motion", "long.npz", "--text", "someone sits", "--keep", "0:20", "--run", str(run), *FAST]
    fails(capsys, [*change, "--out", "edited.npz"], "allowed: 1 to 196 frames", "cut a part of it out (--part 0:196)")
    assert cli.main([*change, "--part", "5s:10s", "--out", "edited.npz"]) == 0
    assert "frames 100:200 of 300" in capsys.readouterr().out
    edited = load_npz("edited.npz")
    assert len(edited.joints) == 100
    assert np.array_equal(edited.features[:20], long.features[100:120])
    np.testing.assert_allclose(edited.joints[:20], long.joints[100:120], atol=1e-4)
    assert cli.main(["export", "long.npz", "--part", "140:160", "--out", "part.npz"]) == 0
    part = load_npz("part.npz")
    assert np.array_equal(part.joints, long.joints[140:160])
    assert np.array_equal(part.kept, long.kept[140:160])
    for wrong in ("0:10,20:30", "prefix", "290:310", "5"):
        fails(
            capsys, ["export", "long.npz", "--part", wrong, "--out", "none.npz"], wrong.partition(",")[0].split(":")[0]
        )


def test_joints_can_be_edited(run, capsys):
    from kinema.data.synthetic import synthetic_clips

    joints = next(iter(synthetic_clips(size=1, seed=0))).joints()[:61]
    np.save("captured.npy", joints.astype(np.float32))
    change = ["edit", "--motion", "captured.npy", "--text", "someone sits", "--run", str(run), *FAST]
    assert cli.main([*change, "--regenerate", "suffix", "--out", "edited.npz"]) == 0
    edited = load_npz("edited.npz")
    assert edited.joints.shape == (61, HUMANML3D.num_joints, 3)
    capsys.readouterr()
    np.save("captured.npy", 1.2 * joints.astype(np.float32))
    assert cli.main([*change, "--keep", "prefix", "--out", "edited.npz"]) == 0
    told = re.search(r"note      kept joints get humanml3d's bones: up to (\d+) cm", capsys.readouterr().out)
    moved = np.linalg.norm(load_npz("edited.npz").joints[:30] - 1.2 * joints[:30], axis=-1).max()
    assert 1 < 100 * moved <= int(told[1]) + 1


@pytest.mark.parametrize("option", ["--keep", "--regenerate"])
@pytest.mark.parametrize(
    ("task", "stays"),
    [("prefix", "0:20"), ("suffix", "20:40"), ("inbetween", "0:10, 30:40"), ("outpaint", "10:30")],
)
def test_a_task_means_what_is_given_whichever_option_names_it(run, capsys, option, task, stays):
    make = ["generate", "a person walks", "--run", str(run), "--frames", "40", "--seed", "3", *FAST]
    assert cli.main([*make, "--out", "walk.npz"]) == 0
    change = ["edit", "--motion", "walk.npz", "--text", "someone sits", "--run", str(run), *FAST]
    assert cli.main([*change, option, task, "--out", "edited.npz"]) == 0
    assert f"kept frames {stays}; largest step at a seam " in capsys.readouterr().out
    walk, edited = load_npz("walk.npz"), load_npz("edited.npz")
    same = (walk.features == edited.features).all(1)
    for span in stays.split(", "):
        start, end = map(int, span.split(":"))
        assert same[start:end].all()
        same[start:end] = False
    assert not same.any()


def test_keyframes_are_widened_to_latents_and_said(run, capsys):
    make = ["generate", "a person walks", "--run", str(run), "--frames", "40", "--seed", "3", *FAST]
    assert cli.main([*make, "--out", "walk.npz"]) == 0
    change = ["edit", "--motion", "walk.npz", "--text", "someone sits", "--run", str(run), *FAST]
    assert cli.main([*change, "--keep", "0:1,39:40", "--out", "edited.npz"]) == 0
    assert "kept frames 0:4, 36:40" in capsys.readouterr().out
    assert cli.main([*change, "--hold", "0,-1", "--out", "edited.npz"]) == 0
    told = capsys.readouterr().out
    assert "held      frames 0, 39, whole latents of 4 frames: within 0.0 cm of where they were" in told
    assert "kept frames 0:4, 36:40" in told
    fails(capsys, [*change, "--hold", "0", "--raw", "--out", "edited.npz"], "leave --raw out")
    fails(capsys, [*change, "--keep", "0:8", "--raw", "--blend", "1", "--out", "edited.npz"], "leave one out")
    (Path.cwd() / "way.csv").write_text("t,x,z\n0,0,0\n1,1,0\n")
    moved = ["edit", "--motion", "walk.npz", "--run", str(run), "--path", "way.csv", "--out", "moved.npz"]
    fails(capsys, [*moved, "--raw", "--seed", "3"], "--seed, --raw without a part that becomes new: leave it out")


@pytest.mark.parametrize("width", [67, 100, 263])
def test_a_motion_with_narrower_rows_has_as_many_frames_and_stays_in_its_place(tmp_path, run, width):
    """A model of redundant dims reads 263 columns."""
    make = ["generate", "a person walks", "--run", str(run), "--frames", "40", "--seed", "3", *FAST]
    assert cli.main([*make, "--out", "walk.npz"]) == 0
    walk = load_npz("walk.npz")
    rows = np.zeros((40, width), np.float32)
    rows[:, :67] = walk.features
    save_npz(replace(walk, features=rows, joints=walk.joints + np.float32([5, 0, 1])), "moved.npz")
    read = read_recording("moved.npz").motion(HUMANML3D, 263)
    assert read.features.shape == (40, 263)
    assert np.array_equal(read.joints, walk.joints + np.float32([5, 0, 1]))
    assert np.array_equal(read.features[:, :67], walk.features)

"""What is generated goes along a way, whatever the method makes."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from kinema import cli
from kinema.data.synthetic import synthetic_catalog
from kinema.motion.formats.arrays import load_npz
from kinema.motion.recovery import recover_joints
from kinema.motion.skeleton import HUMANML3D
from kinema.motion.waypoints import Waypoints
from kinema.pipeline.following import follow

WAY = Waypoints(np.array([0.0, 1.5, 3.0]), np.array([[0.0, 0.0], [0.0, 2.0], [2.0, 2.0]]), None)


def test_motions_are_carried_along_and_rows_tell_the_same(model):
    made = follow(model, ["a person walks", "a man jumps"], WAY, 60, seed=1)
    assert made.strides is not None
    assert len(made.strides) == 2
    places = WAY.at(60)[0]
    for motion in made.motions:
        assert motion.joints.shape == (60, 22, 3)
        np.testing.assert_allclose(motion.joints[[0, -1], 0][:, [0, 2]], places[[0, -1]], atol=1e-4)
        rows = recover_joints(torch.from_numpy(motion.features), HUMANML3D).numpy()
        steps = [np.linalg.norm(np.diff(j[:, 0], axis=0), axis=-1) for j in (rows, motion.joints)]
        np.testing.assert_allclose(*steps, atol=1e-4)
    found = [np.linalg.norm(m.joints[:, 0, [0, 2]] - places, axis=-1).mean() for m in made.motions]
    assert made.away == pytest.approx(np.mean(found))
    again = follow(model, ["a person walks", "a man jumps"], WAY, 60, seed=1)
    assert np.array_equal(again.motions[1].features, made.motions[1].features)


def test_a_way_says_how_long_the_motion_is(model):
    assert len(follow(model, ["a person walks"], WAY, seed=1).motions[0].joints) == 61


def test_the_command_says_how_far_from_the_way_it_is(run, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "way.csv").write_text("time,x,z\n0,0,0\n1,0,2\n2,2,2\n")
    make = ["generate", "a person walks", "--run", str(run), "--seed", "3", "--path", "way.csv"]
    assert cli.main([*make, "--out", "walk.npz"]) == 0
    told = capsys.readouterr().out
    assert told.startswith("read way.csv: x, z of each row, at their times; 4.0 m at 2 m/s\n")
    assert "path      4.0 m: the root is " in told
    assert len(load_npz("walk.npz").features) == 41
    assert cli.main([*make, "--chain", "--out", "walk.npz"]) == 2
    assert "leave --chain and lengths of prompts out" in capsys.readouterr().err
    (tmp_path / "way.csv").write_text("time,x,z\n0,0,0\n100,0,2\n")
    assert cli.main([*make, "--out", "walk.npz"]) == 2
    assert "give --seconds to go it faster" in capsys.readouterr().err
    (tmp_path / "way.csv").write_text("time,x,z\n0,0,0\n1,0,40\n")
    assert cli.main([*make, "--out", "walk.npz"]) == 2
    assert "40.0 m at 40 m/s, and nobody runs faster than 12.5: give --seconds" in capsys.readouterr().err
    assert cli.main([*make, "--seconds", "8", "--out", "walk.npz"]) == 0


def test_a_motion_is_taken_along_and_what_becomes_new_begins_there(run, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "way.csv").write_text("time,x,z\n0,1,0\n1.5,1,1\n3,2,1\n")
    clip = max(
        (c.joints()[:80] for c in synthetic_catalog(size=20, seed=3)), key=lambda j: np.ptp(j[:, 0], axis=0).max()
    )
    np.save("walk.npy", clip.astype(np.float32))
    change = ["edit", "--motion", "walk.npy", "--run", str(run), "--path", "way.csv"]
    assert cli.main([*change, "--out", "along.npz"]) == 0
    told = capsys.readouterr().out
    assert "path      2.0 m: the root is " in told
    assert "wrote along.npz (61 frames)\n" in told
    along = load_npz("along.npz")
    np.testing.assert_allclose(along.joints[[0, -1], 0][:, [0, 2]], [[1, 0], [2, 1]], atol=1e-4)
    assert cli.main([*change, "--keep", ":32", "--text", "sits", "--seed", "3", "--out", "sits.npz"]) == 0
    sits = load_npz("sits.npz")
    assert np.array_equal(sits.features[:32], along.features[:32, :67])
    np.testing.assert_allclose(sits.joints[:32], along.joints[:32], atol=1e-4)
    for words, message in (
        ([*change, "--keep", ":32"], "--text is missing"),
        ([*change, "--text", "sits"], "--text without a part that becomes new"),
        (change[:-2], "or --path FILE for another way over the floor"),
    ):
        assert cli.main([*words, "--out", "no.npz"]) == 2
        assert message in capsys.readouterr().err
    (tmp_path / "way.csv").write_text("x,z\n0,0\n0,1\n2,2\n")
    assert cli.main([*change, "--out", "no.npz"]) == 2
    assert "nobody runs faster than 12.5: give its rows a time, or write it in metres" in capsys.readouterr().err
    assert not (tmp_path / "no.npz").exists()

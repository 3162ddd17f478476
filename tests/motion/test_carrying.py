"""A motion that is carried along a way goes there, faces it, and its feet slide little more than before."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from kinema.data.synthetic import synthetic_catalog
from kinema.motion.carrying import carry, course, smooth
from kinema.motion.features import extract, facing_yaw
from kinema.motion.physics import foot_skating
from kinema.motion.recovery import recover_joints
from kinema.motion.skeleton import HUMANML3D
from kinema.motion.trajectory import Trajectory
from kinema.motion.waypoints import Waypoints, read_waypoints


@pytest.fixture(scope="module")
def walk():
    """Rows of the synthetic clip that goes farthest in 100 frames."""
    rows = [extract(clip.joints(), HUMANML3D)[:100] for clip in synthetic_catalog(size=120, seed=3)]
    return max((r for r in rows if len(r) == 100), key=lambda r: np.ptp(Trajectory.of(r).place, axis=0).max())


def skating(joints):
    return float(foot_skating(torch.tensor(joints)[None], torch.tensor([len(joints)]), HUMANML3D))


def bend(length: float, frames: int = 100):
    """An L of two legs, to +Z and then to +X."""
    way = Waypoints(np.array([0, 2.4, 2.6, 5.0]), length * np.array([[0, 0], [0, 0.48], [0.04, 0.5], [0.5, 0.5]]), None)
    return way.at(frames)[0]


def test_it_goes_along_and_faces_the_way_and_feet_stand(walk):
    own = Trajectory.of(walk)
    places = bend(float(np.linalg.norm(np.diff(own.place, axis=0), axis=-1).sum())) + np.array([3.0, -1.0])
    rows, way, stride = carry(walk, places, None, HUMANML3D)
    assert 0.8 < stride < 1.2
    joints = way.joints(rows, HUMANML3D)
    assert np.linalg.norm(joints[:, 0, [0, 2]] - places, axis=-1).mean() < 0.08
    assert np.linalg.norm(joints[-1, 0, [0, 2]] - places[-1]) < 0.05
    faced = [np.degrees(-facing_yaw(joints[i : i + 1].astype(float), HUMANML3D)) for i in (20, 80)]
    assert abs(faced[0]) < 30
    assert abs(faced[1] - 90) < 30
    before = recover_joints(torch.from_numpy(walk), HUMANML3D).numpy()
    assert skating(joints) < skating(before) + 0.15
    again = recover_joints(torch.from_numpy(rows), HUMANML3D).numpy()
    np.testing.assert_allclose(np.diff(again[:, 0, 1]), np.diff(joints[:, 0, 1]), atol=1e-5)
    np.testing.assert_allclose(
        np.linalg.norm(again[:, 10] - again[:, 0], axis=-1),
        np.linalg.norm(joints[:, 10] - joints[:, 0], axis=-1),
        atol=1e-4,
    )


def test_headings_turn_the_body_alone(walk):
    places = bend(4.0)
    plain, backwards = (carry(walk, places, h, HUMANML3D) for h in (None, np.full(100, np.pi)))
    np.testing.assert_allclose(plain[1].place, backwards[1].place)
    joints = backwards[1].joints(backwards[0], HUMANML3D).astype(float)
    assert all(np.cos(-facing_yaw(joints[i : i + 1], HUMANML3D)) < -0.7 for i in (20, 50, 80))


def test_its_own_way_gives_the_motion_again(walk):
    places = smooth(Trajectory.of(walk).place, 8.0)
    rows, way, stride = carry(walk, places, None, HUMANML3D)
    assert stride == pytest.approx(1)
    turned = way.joints(rows, HUMANML3D)
    own = recover_joints(torch.from_numpy(walk), HUMANML3D).numpy()
    np.testing.assert_allclose(turned, own, atol=1e-3)


def test_a_motion_that_stands_is_refused(walk):
    with pytest.raises(ValueError, match=r"take one that walks or runs \(say so in the text\)"):
        carry(np.repeat(walk[:1] * [0, 0, 0, *[1] * 260], 40, 0).astype(np.float32), bend(4.0, 40), None, HUMANML3D)


def test_a_course_is_that_of_around_where_nothing_moves():
    places = np.concatenate([np.zeros((20, 2)), np.arange(1, 31)[:, None] * [0.1, 0]])
    assert course(places, 20.0)[[0, 10, -1]] == pytest.approx([np.pi / 2] * 3, abs=0.01)


def test_ways_are_read_alike(tmp_path):
    table = np.array([[0, 0, 0], [1, 0, 90], [1, 2, 180.0]])
    (tmp_path / "a.csv").write_text(
        "time, x, z, heading\n" + "\n".join(f"{i},{x},{z},{h}" for i, (x, z, h) in enumerate(table))
    )
    np.savez(tmp_path / "a.npz", path=table[:, :2], headings=table[:, 2], times=np.arange(3.0))
    for one in (read_waypoints(tmp_path / f"a.{kind}", 1.0) for kind in ("csv", "npz")):
        assert one.frames(20) == 41
        places, headings = one.at(41)
        np.testing.assert_allclose(places[[0, 20, 40]], table[:, :2])
        np.testing.assert_allclose(headings[[0, 20, 40]], np.radians(table[:, 2]))
        assert places[:, 0].max() <= 1  # it never swings over
        assert one.note == "x, z, heading of each row, at their times"


def test_columns_without_names_are_places_on_the_floor_or_in_space(tmp_path):
    x, y, z = [0, 1.0, 2.0], [0.9, 1.0, 0.2], [0, 0.5, 3.0]
    (tmp_path / "named.csv").write_text("x,y,z\n" + "\n".join(f"{a},{b},{c}" for a, b, c in zip(x, y, z, strict=True)))
    np.save(tmp_path / "floor.npy", np.stack([x, z], 1))
    np.save(tmp_path / "space.npy", np.stack([x, y, z], 1).astype(np.float32))
    np.savez(tmp_path / "space.npz", path=np.stack([x, y, z], 1))
    for name in ("named.csv", "floor.npy", "space.npy", "space.npz"):
        way = read_waypoints(tmp_path / name, 1.0)
        np.testing.assert_allclose(way.places, np.stack([x, z], 1))
        assert way.headings is None
        assert way.note.startswith("x, z of each row, one row a frame of 1 a second")
        assert ("heights (y, 0.20 to 1.00 m) are left out" in way.note) == (name != "floor.npy")


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ([[0, 0, 0], [0, 2.5, 90]], "the height .* goes from 0 to 2.5 m; leave heights out, or name headings"),
        ([[0, 0, 0, 0], [0, 1, 0, 0]], r"holds \(2, 4\); two columns are x, z, three x, y, z"),
        ([[0, 0]], "holds 1 rows; at least two"),
    ],
)
@pytest.mark.parametrize("kind", ["npy", "npz"])
def test_columns_that_cannot_be_places_are_told(tmp_path, kind, table, message):
    path = tmp_path / f"a.{kind}"
    np.save(path, np.array(table, float)) if kind == "npy" else np.savez(path, path=np.array(table, float))
    with pytest.raises(ValueError, match=message):
        read_waypoints(path, 20.0)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.csv", "x,y\n0,0\n", "has no column z"),
        ("a.csv", "x,z\n0,0\n", "at least two rows"),
        ("a.csv", "x,z\n0,0\n1,up\n", "no number"),
        ("a.csv", "x,z\n0,0\n1,nan\n", "NaN"),
        ("a.csv", "x,z,time\n0,0,1\n1,0,1\n", "times must rise from row to row, row 2"),
        ("a.csv", "x,z,time\n0,0,0\n1,0,1e308\n", "goes 1 m far in 1e\\+308 s; allowed: up to 10000"),
        ("a.csv", "x,z\n0,0\n1e9,0\n", "goes 1e\\+09 m far"),
        ("a.txt", "", "no way over the floor"),
    ],
)
def test_a_wrong_file_is_named(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises(ValueError, match=message):
        read_waypoints(tmp_path / name, 20.0)

"""A body is what balls along its bones cover, each nearer one before the others; no pose is too odd to be drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kinema.motion import export
from kinema.motion.skeleton import HUMANML3D, KIT
from kinema.motion.view.body import LEFT, RIGHT, body_of, metres
from kinema.motion.view.volume import LIGHT, look, pieces
from kinema.types import Motion


def motion(wander, skeleton, frames=3) -> Motion:
    return Motion(wander(skeleton, frames), np.zeros((frames, 1)), "turns", skeleton.name, skeleton.fps)


def covered(bone: np.ndarray, width: int, height: int) -> np.ndarray:
    """Look at thousands of balls from one end of a bone to the other."""
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height)[::-1] + 0.5)
    near = np.full((height, width), -np.inf)
    for share in np.linspace(0, 1, 2001):
        a, b, c, r = bone[0] + share * (bone[1] - bone[0])
        q = r * r - (x - a) ** 2 - (y - b) ** 2
        near = np.where(q >= 0, np.maximum(near, c + np.sqrt(np.maximum(q, 0))), near)
    return near


BONES = {
    "aside": [[8, 10, 0, 5], [30, 22, 3, 2]],
    "towards the viewer": [[15, 15, -20, 6], [17, 16, 10, 3]],
    "away": [[15, 15, 20, 3], [18, 20, -10, 7]],
    "straight at the viewer": [[15, 15, -9, 6], [15, 15, 9, 4]],
    "straight away": [[15, 15, 9, 4], [15, 15, -9, 6]],
    "one in the other": [[15, 15, 0, 9], [17, 15, 1, 3]],
    "a ball": [[15, 15, 0, 6], [15, 15, 0, 6]],
    "over the edge": [[-4, 10, 0, 8], [50, 40, 5, 6]],
}


@pytest.mark.parametrize("kind", BONES)
def test_a_skin_is_what_the_balls_along_a_bone_cover(kind):
    bone = np.array(BONES[kind], dtype=float)
    seen, expected = look(bone[None], [0], 40, 32).near, covered(bone, 40, 32)
    there = np.isfinite(expected)
    assert there.sum() > 50
    assert (np.isfinite(seen) ^ there).sum() <= 0.02 * there.sum()  # the edge, between two of the thousands
    both = there & np.isfinite(seen)
    np.testing.assert_allclose(seen[both], expected[both], atol=0.02)


def test_the_nearer_bone_is_seen_and_lit_as_it_lies():
    bones = np.array([[[10, 10, 5, 6], [10, 10, 5, 6]], [[10, 10, 0, 9], [10, 10, 0, 9]]], dtype=float)
    for order in ((0, 1), (1, 0)):
        seen = look(bones[list(order)], list(order), 20, 20)
        assert seen.piece[9, 9] == 0
        assert seen.piece[9, 2] == 1
        assert seen.piece[0, 0] == -1
        assert seen.light[9, 9] == pytest.approx(LIGHT[2], abs=0.1)
        assert seen.light[4, 7] > seen.light[9, 9] > seen.light[14, 13]  # from the upper left


@pytest.mark.parametrize("skeleton", [HUMANML3D, KIT], ids=lambda s: s.name)
def test_a_body_covers_its_joints_and_has_two_alike_sides(skeleton, wander):
    made = motion(wander, skeleton)
    body, pose = body_of(made), metres(made)[0]
    parts = pieces(pose, body)
    balls = np.concatenate([part.balls for part in parts])
    for joint, place in enumerate(pose):
        if body.sides[joint] or joint not in (body.head, body.parents[body.head]):
            assert (np.linalg.norm(balls[:, :3] - place, axis=-1) < balls[:, 3] + 0.05 * body.stature).any()
    assert sum(part.side == LEFT for part in parts) == sum(part.side == RIGHT for part in parts) > 4
    assert np.ptp(balls[:, 1] + balls[:, 3]) < 1.3 * body.stature


@pytest.mark.parametrize("skeleton", [HUMANML3D, KIT], ids=lambda s: s.name)
@pytest.mark.parametrize("kind", ["of no size", "far", "huge", "noise"])
def test_any_finite_pose_is_drawn(kind, skeleton, wander, tmp_path):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed: pip install 'kinema[viz]'")
    made = motion(wander, skeleton)
    joints = {
        "of no size": np.ones_like(made.joints),
        "far": np.where(np.arange(skeleton.num_joints)[:, None] == skeleton.num_joints - 1, 500.0, made.joints),
        "huge": made.joints * 1e4,
        "noise": np.random.default_rng(0).normal(size=made.joints.shape) / skeleton.meters,
    }[kind]
    path = export.save(replace(made, joints=joints.astype(np.float32)), tmp_path / "strip.png")
    assert path.stat().st_size > 1000

"""What an export changes, and what it leaves."""

from __future__ import annotations

import numpy as np
import pytest

from kinema.data.synthetic import synthetic_catalog
from kinema.motion.rig.changes import Changes
from kinema.motion.rig.fit import fit_rig
from kinema.motion.rig.pose import HUMANML3D_REST


@pytest.fixture(scope="module")
def walk():
    clip = next(iter(synthetic_catalog(size=8, seed=2)))
    return fit_rig(clip.joints(), HUMANML3D_REST, 20)


def test_nothing_asked_changes_nothing(walk):
    assert Changes().apply(walk) is walk


def test_in_place_keeps_the_pose_and_the_height(walk):
    still = Changes(in_place=True).apply(walk)
    assert np.ptp(still.positions[:, 0, [0, 2]], axis=0).max() == 0
    away = walk.positions - walk.positions[:, :1] * [1, 0, 1]
    np.testing.assert_allclose(still.positions - still.positions[:, :1] * [1, 0, 1], away, atol=1e-9)


@pytest.mark.parametrize(("degrees", "way"), [(0, [0, 1]), (90, [1, 0]), (-180, [0, -1])])
def test_the_first_frame_faces_as_asked_from_the_origin(degrees, way, walk):
    turned = Changes(facing=degrees).apply(walk)
    across = turned.positions[0, 1] - turned.positions[0, 2]
    forward = np.array([-across[2], across[0]])  # left x up
    assert forward @ way / np.linalg.norm(forward) > 0.85
    np.testing.assert_allclose(turned.positions[0, 0, [0, 2]], 0, atol=1e-9)


def test_a_loop_ends_in_its_first_pose_where_it_has_come_to(walk):
    loop = Changes(loop=True).apply(walk)
    local = loop.positions - loop.positions[:, :1] * [1, 0, 1]
    for ends in (0, -1):
        yaw = np.arctan2(loop.rotations[ends, 0, 0, 2], loop.rotations[ends, 0, 2, 2])
        turn = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
        local[ends] = local[ends] @ turn
    np.testing.assert_allclose(local[-1], local[0], atol=1e-6)
    np.testing.assert_array_equal(loop.positions[:-10], walk.positions[:-10])
    np.testing.assert_allclose(loop.positions[:, 0, [0, 2]], walk.positions[:, 0, [0, 2]], atol=1e-9)


def test_z_up_turns_everything_and_mirrors_nothing(walk):
    up = Changes(z_up=True).apply(walk)
    x, y, z = np.moveaxis(walk.positions, -1, 0)
    np.testing.assert_allclose(up.positions, np.stack([x, -z, y], -1), atol=1e-9)
    assert np.linalg.det(up.rotations) == pytest.approx(1)


def test_another_rate_keeps_the_frames_it_shares(walk):
    fast = Changes(fps=60).apply(walk)
    np.testing.assert_allclose(fast.positions[::3], walk.positions, atol=1e-9)
    assert fast.frames == 3 * (walk.frames - 1) + 1

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from kinema.motion.rotation import matrix_from_sixd, rotate_yaw, shortest_arc, sixd_from_matrix, unit, yaw_matrix


def test_yaws_agree_with_scipy():
    rng = np.random.default_rng(0)
    points, yaw = rng.normal(size=(7, 5, 3)), rng.uniform(-4, 4, size=7)
    expected = np.stack([Rotation.from_euler("y", a).apply(p) for a, p in zip(yaw, points, strict=True)])
    np.testing.assert_allclose(rotate_yaw(points, yaw), expected, atol=1e-12)
    turned = torch.from_numpy(points) @ yaw_matrix(torch.from_numpy(yaw)).mT
    np.testing.assert_allclose(turned.numpy(), expected, atol=1e-12)


def test_a_shortest_arc_is_the_least_rotation_between_two_directions():
    rng = np.random.default_rng(1)
    source, target = unit(rng.normal(size=(2, 50, 3)))
    matrices = shortest_arc(source, target)
    np.testing.assert_allclose((matrices @ source[..., None])[..., 0], target, atol=1e-12)
    angle = Rotation.from_matrix(matrices).magnitude()
    np.testing.assert_allclose(angle, np.arccos(np.sum(source * target, axis=-1)), atol=1e-7)


@pytest.mark.parametrize("offset", [0.0, 1e-7, 1e-4])
def test_opposite_directions_get_a_proper_half_turn(offset):
    source = np.concatenate([np.eye(3), unit(np.ones((1, 3)))])
    target = unit(-source + offset * np.roll(source, 1, axis=-1))
    matrices = shortest_arc(source, target)
    np.testing.assert_allclose((matrices @ source[..., None])[..., 0], target, atol=1e-6)
    np.testing.assert_allclose(
        matrices @ np.swapaxes(matrices, -1, -2), np.broadcast_to(np.eye(3), (4, 3, 3)), atol=1e-5
    )
    np.testing.assert_allclose(np.linalg.det(matrices), 1, atol=1e-5)


def test_sixd_round_trips_and_orthonormalises():
    matrices = Rotation.random(20, random_state=2).as_matrix()
    sixd = torch.from_numpy(sixd_from_matrix(matrices))
    np.testing.assert_allclose(matrix_from_sixd(sixd).numpy(), matrices, atol=1e-12)
    sloppy = matrix_from_sixd(sixd * 3 + 0.2)
    torch.testing.assert_close(sloppy @ sloppy.mT, torch.eye(3, dtype=sloppy.dtype).expand(20, 3, 3))

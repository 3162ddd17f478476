"""Rotate: yaws about +Y, shortest arcs, the 6D form of a rotation matrix.

A yaw theta maps x' = cos x + sin z, z' = -sin x + cos z (HUMANML3D_DATA §1). Extraction is numpy, recovery torch.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

SINGULAR = 1e-10
"""Below this value of 1 + cos a shortest arc's axis is taken from the fallback (float64)."""


def unit(vectors: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Scale vectors to length one; zero vectors stay zero."""
    norm = np.sqrt(np.einsum("...i,...i->...", vectors, vectors))[..., None]
    return vectors / np.where(norm > 0, norm, 1)


def rotate_yaw(
    vectors: Float[np.ndarray, "t *n 3"], yaw: Float[np.ndarray, " t"] | float
) -> Float[np.ndarray, "t *n 3"]:
    """Turn vectors about +Y by one yaw, or by one yaw per frame."""
    yaw = np.asarray(yaw)
    yaw = yaw.reshape(yaw.shape + (1,) * (vectors.ndim - 2)) if yaw.ndim else yaw
    cos, sin = np.cos(yaw), np.sin(yaw)
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack([cos * x + sin * z, y, cos * z - sin * x], axis=-1)


def shortest_arc(source: Float[np.ndarray, "*#n 3"], target: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3 3"]:
    """Make the rotation matrices of least angle that take unit vectors `source` to unit vectors `target`.

    R = cos I + [v]x + v v^T / (1 + cos), v = source x target. Opposite vectors have no shortest arc: they are turned
    by pi about an axis perpendicular to `source` (the published code gives NaN and drops the clip).
    """
    source, target = np.broadcast_arrays(source, target)
    cos = np.einsum("...i,...i->...", source, target)
    (a, b, c), (x, y, z) = np.moveaxis(source, -1, 0), np.moveaxis(target, -1, 0)
    u, v, w = b * z - c * y, c * x - a * z, a * y - b * x
    singular = 1 + cos < SINGULAR
    k = 1 / np.where(singular, 1, 1 + cos)
    rows = [
        [cos + u * u * k, u * v * k - w, u * w * k + v],
        [u * v * k + w, cos + v * v * k, v * w * k - u],
        [u * w * k - v, v * w * k + u, cos + w * w * k],
    ]
    matrices = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    if singular.any():
        matrices[singular] = _half_turn(source[singular])
    return matrices


def _half_turn(vectors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
    """Turn by pi about an axis perpendicular to each vector: R = 2 n n^T - I."""
    helper = np.eye(3)[np.argmin(np.abs(vectors), axis=-1)]
    axis = unit(np.cross(vectors, helper))
    return 2 * axis[:, :, None] * axis[:, None, :] - np.eye(3)


def sixd_from_matrix(matrices: Float[np.ndarray, "*n 3 3"]) -> Float[np.ndarray, "*n 6"]:
    """Write rotations as their first two columns, one after the other."""
    return np.concatenate([matrices[..., 0], matrices[..., 1]], axis=-1)


def matrix_from_sixd(sixd: Float[Tensor, "*n 6"]) -> Float[Tensor, "*n 3 3"]:
    """Orthonormalise 6D rotations: c0 = unit(a1), c2 = unit(c0 x a2), c1 = c2 x c0 (columns)."""
    first = torch.nn.functional.normalize(sixd[..., :3], dim=-1)
    third = torch.nn.functional.normalize(torch.linalg.cross(first, sixd[..., 3:6]), dim=-1)
    return torch.stack([first, torch.linalg.cross(third, first), third], dim=-1)


def yaw_matrix(yaw: Float[Tensor, "*n"]) -> Float[Tensor, "*n 3 3"]:
    """Make the rotation matrices of yaws about +Y."""
    cos, sin, zero, one = yaw.cos(), yaw.sin(), torch.zeros_like(yaw), torch.ones_like(yaw)
    rows = [(cos, zero, sin), (zero, one, zero), (-sin, zero, cos)]
    return torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)

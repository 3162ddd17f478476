"""Write turns as Euler angles that don't jump."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation


def continuous_euler(rotations: Float[np.ndarray, "t j 3 3"], axes: str = "ZXY") -> Float[np.ndarray, "t j 3"]:
    """Give degrees about own axes, each frame's nearest to the frame before: a turn of two rounds ends at 720.

    Every turn has two triples of angles, (a, b, c) and (a + 180, 180 - b, c + 180), each up to full turns.
    """
    frames, joints = rotations.shape[:2]
    first = Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_euler(axes, degrees=True).reshape(frames, joints, 3)
    second = np.stack([first[..., 0] + 180, 180 - first[..., 1], first[..., 2] + 180], axis=-1)
    found = np.empty_like(first)
    found[0] = first[0]
    for frame in range(1, frames):
        before = found[frame - 1]
        near = [angles - 360 * np.round((angles - before) / 360) for angles in (first[frame], second[frame])]
        further = np.abs(near[0] - before).sum(-1) > np.abs(near[1] - before).sum(-1)
        found[frame] = np.where(further[:, None], near[1], near[0])
    return found

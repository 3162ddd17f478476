"""Give clips that move like nothing in particular but exercise everything: turns, steps, bending bones."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from kinema.motion.kinematics import place_joints
from kinema.motion.rotation import rotate_yaw, unit
from kinema.motion.skeleton import Skeleton


@pytest.fixture(scope="session")
def wander() -> Callable[..., np.ndarray]:
    """Make joints (frames, J, 3) by a seeded random walk; `turn` is the yaw rate in radians per frame."""

    def make(skeleton: Skeleton, frames: int = 60, seed: int = 0, turn: float = 0.02) -> np.ndarray:
        rng = np.random.default_rng(seed)
        scale = 1 / skeleton.meters
        lengths = skeleton.bone_lengths if skeleton.bone_lengths is not None else _lengths(skeleton)
        sway = gaussian_filter1d(rng.normal(size=(frames + 40, skeleton.num_joints, 3)), 4, axis=0)[:frames]
        bones = unit(skeleton.rest_directions + sway) * lengths[:, None]
        path = np.cumsum(rng.normal(scale=0.01 * scale, size=(frames, 3)), axis=0)
        return place_joints(path, rotate_yaw(bones, turn * np.arange(frames) + 0.3), skeleton)

    return make


def _lengths(skeleton: Skeleton) -> np.ndarray:
    lengths = np.linspace(80, 300, skeleton.num_joints)
    lengths[0] = 0
    return lengths

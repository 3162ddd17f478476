"""Mirror a motion left to right (HUMANML3D_DATA §2.6)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from kinema.motion.skeleton import Skeleton


def mirror_joints(joints: Float[np.ndarray, "*t j 3"], skeleton: Skeleton) -> Float[np.ndarray, "*t j 3"]:
    """Negate x and swap left with right joints.

    Mirror joints and extract again rather than mirroring feature rows: those also change in sign patterns of the 6D
    rotations.
    """
    order = np.arange(skeleton.num_joints)
    for left, right in skeleton.mirror_pairs:
        order[[left, right]] = right, left
    mirrored = joints[..., order, :]
    mirrored[..., 0] *= -1
    return mirrored

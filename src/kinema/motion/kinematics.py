"""Measure and replace bones: vectors, lengths, and positions rebuilt along the chains."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from kinema.motion.rotation import unit
from kinema.motion.skeleton import Skeleton


def bone_vectors(joints: Float[np.ndarray, "*t j 3"], skeleton: Skeleton) -> Float[np.ndarray, "*t j 3"]:
    """Subtract from every joint its parent; the root's vector is zero."""
    return joints - joints[..., _parents_or_self(skeleton), :]


def bone_lengths(joints: Float[np.ndarray, "*t j 3"], skeleton: Skeleton) -> Float[np.ndarray, "*t j"]:
    """Measure the bone that ends at each joint; the root's is zero."""
    return np.linalg.norm(bone_vectors(joints, skeleton), axis=-1)


def place_joints(
    root: Float[np.ndarray, "*t 3"], bones: Float[np.ndarray, "*t j 3"], skeleton: Skeleton
) -> Float[np.ndarray, "*t j 3"]:
    """Rebuild positions from the root path and global bone vectors."""
    return root[..., None, :] + skeleton.ancestry @ bones


def uniform_skeleton(
    joints: Float[np.ndarray, "t j 3"], skeleton: Skeleton, target_bone_lengths: np.ndarray
) -> Float[np.ndarray, "t j 3"]:
    """Return the clip the target's bone lengths (J,), keeping bone directions (HUMANML3D_DATA §3.1).

    The root path is scaled by the ratio of the target's leg (knee and ankle bones) to that of frame 0.
    """
    target = np.asarray(target_bone_lengths, dtype=np.float64)
    if target.shape != (skeleton.num_joints,) or not (target[1:] > 0).all():
        raise ValueError(
            f"target_bone_lengths must be {skeleton.num_joints} lengths, positive from joint 1 on, got {target}; "
            "kinema.motion.kinematics.bone_lengths measures them on a reference frame"
        )
    legs = list(skeleton.leg_joints)
    vectors = bone_vectors(joints, skeleton)
    ratio = target[legs].sum() / np.linalg.norm(vectors[0, legs], axis=-1).sum()
    return place_joints(joints[:, 0] * ratio, unit(vectors) * target[:, None], skeleton)


def _parents_or_self(skeleton: Skeleton) -> list[int]:
    return [max(parent, 0) for parent in skeleton.parents]

"""Turn joint positions into the HumanML3D / KIT-ML feature rows, quirks included (HUMANML3D_DATA §3).

All frames of a clip at once, in float64; rows come out as float32. Three quirks must be kept, since every published
number rests on them: the angular velocity is half the yaw increment; the per-frame heading flips the sign of the hip
vector and pretends that frame 0 faces +Z; arm chains turn relative to the heading.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter1d

from kinema.motion.kinematics import bone_vectors, uniform_skeleton
from kinema.motion.rotation import rotate_yaw, shortest_arc, sixd_from_matrix, unit
from kinema.motion.skeleton import Skeleton

HEADING_SIGMA = 20.0
"""Standard deviation, in frames, of the Gaussian that smooths the heading (cut at 4 sigma)."""


def extract(
    joints: np.ndarray,
    skeleton: Skeleton,
    *,
    target_bone_lengths: np.ndarray | str | None = None,
    canonical: bool = True,
) -> Float[np.ndarray, "t d"]:
    """Make the feature rows of a clip of joints (T, J, 3) in the skeleton's unit; T frames give T-1 rows.

    `target_bone_lengths` replaces the bone lengths ("skeleton": by the skeleton's own); None keeps them. `canonical`
    puts the clip on the floor, at the origin and facing +Z first; without it the clip must be so already. Raises
    ValueError for a wrong shape, fewer than 2 frames, NaN or a bone without length.
    """
    joints = _checked(joints, skeleton)
    if target_bone_lengths is not None:
        joints = uniform_skeleton(joints, skeleton, _target(target_bone_lengths, skeleton))
    if canonical:
        joints = canonicalise(joints, skeleton)
    yaw = heading(joints, skeleton)
    # Extraction works on world positions, so each group only has to pick its index and its rotation.
    step = np.diff(joints, axis=0)
    local = rotate_yaw(joints[:-1] - joints[:-1, :1] * (1, 0, 1), yaw[:-1])
    root_step = rotate_yaw(step[:, 0], yaw[1:])
    rows = np.concatenate(
        [
            _wrapped(np.diff(yaw))[:, None] / 2,
            root_step[:, [0, 2]],
            joints[:-1, 0, 1:2],
            _flat(local[:, 1:]),
            _flat(sixd_from_matrix(local_rotations(joints[:-1], yaw[:-1], skeleton))[:, 1:]),
            _flat(rotate_yaw(step, yaw[:-1])),
            contacts(joints, skeleton),
        ],
        axis=1,
    )
    return rows.astype(np.float32)


def extract_every(
    joints: np.ndarray, skeleton: Skeleton, *, target_bone_lengths: np.ndarray | str | None = None
) -> Float[np.ndarray, "t d"]:
    """Make a row for every frame; the last has no step to a next frame, so it repeats the velocities before it.

    The rows in front of it are those of `extract`, which smooths the heading as if the last frame were held.
    """
    checked = _checked(joints, skeleton)
    held = np.concatenate((checked, checked[-1:]))
    rows = extract(held, skeleton, target_bone_lengths=target_bone_lengths)
    for group in ("root_yaw", "root_linear", "velocities", "contacts"):
        rows[-1, skeleton.groups[group]] = rows[-2, skeleton.groups[group]]
    return rows


def canonicalise(joints: Float[np.ndarray, "t j 3"], skeleton: Skeleton) -> Float[np.ndarray, "t j 3"]:
    """Put a clip on the floor, its first root at the origin, its first frame facing +Z."""
    return to_facing(to_origin(to_floor(joints)), skeleton)


def to_floor(joints: Float[np.ndarray, "t j 3"]) -> Float[np.ndarray, "t j 3"]:
    """Shift a clip so that its lowest joint, over all frames, has height 0."""
    return joints - (0, joints[..., 1].min(), 0)


def to_origin(joints: Float[np.ndarray, "t j 3"]) -> Float[np.ndarray, "t j 3"]:
    """Shift a clip so that the first frame's root has x = z = 0."""
    return joints - joints[0, 0] * (1, 0, 1)


def to_facing(joints: Float[np.ndarray, "t j 3"], skeleton: Skeleton) -> Float[np.ndarray, "t j 3"]:
    """Turn a clip about +Y so that its first frame faces +Z; one whose hips and shoulders lie upright stays."""
    return rotate_yaw(joints, facing_yaw(joints, skeleton))


def facing_yaw(joints: Float[np.ndarray, "t j 3"], skeleton: Skeleton) -> float:
    """Return the yaw that turns a clip's first frame to +Z; 0 where hips and shoulders lie upright."""
    right_hip, left_hip, right_shoulder, left_shoulder = (joints[:1, joint] for joint in skeleton.face_joints)
    across = unit((right_hip - left_hip) + (right_shoulder - left_shoulder))
    return _yaw_to_front(_forward(across)).item()


def heading(joints: Float[np.ndarray, "t j 3"], skeleton: Skeleton) -> Float[np.ndarray, " t"]:
    """Return the yaw that takes each frame's smoothed forward direction to +Z; 0 at frame 0 (HUMANML3D_DATA §3.6).

    The hip vector enters with the opposite sign of the shoulder vector: a published bug that the data carry.
    """
    right_hip, left_hip, right_shoulder, left_shoulder = (joints[:, joint] for joint in skeleton.face_joints)
    across = unit((left_hip - right_hip) + (right_shoulder - left_shoulder))
    forward = gaussian_filter1d(_forward(across), HEADING_SIGMA, axis=0, mode="nearest")
    yaw = _yaw_to_front(forward)
    yaw[0] = 0
    return yaw


def contacts(joints: Float[np.ndarray, "t j 3"], skeleton: Skeleton) -> Bool[np.ndarray, "t-1 4"]:
    """Mark feet that hardly move to the next frame: left ankle, toe, right ankle, toe (HUMANML3D_DATA §3.5)."""
    step = np.diff(joints[:, [*skeleton.feet_left, *skeleton.feet_right]], axis=0)
    return np.square(step).sum(-1) < skeleton.contact_threshold


def local_rotations(
    joints: Float[np.ndarray, "t j 3"], yaw: Float[np.ndarray, " t"], skeleton: Skeleton
) -> Float[np.ndarray, "t j 3 3"]:
    """Return each bone's orientation relative to its predecessor's; joint 0 holds the heading (HUMANML3D_DATA §3.9).

    A bone's orientation is the shortest arc from its rest direction, so it knows nothing of twist.
    """
    orientation = np.empty((*joints.shape, 3))
    orientation[:, 0] = _yaw_matrices(yaw)
    directions = unit(bone_vectors(joints, skeleton))[:, 1:]
    orientation[:, 1:] = shortest_arc(skeleton.rest_directions[1:], directions)
    local = orientation.copy()
    previous = orientation[:, skeleton.rotation_parents[1:]]
    local[:, 1:] = np.swapaxes(previous, -1, -2) @ orientation[:, 1:]
    return local


def _forward(across: Float[np.ndarray, "t 3"]) -> Float[np.ndarray, "t 3"]:
    """Cross +Y with the direction from left to right; a lying figure's is short."""
    return np.stack([across[..., 2], np.zeros_like(across[..., 0]), -across[..., 0]], axis=-1)


def _yaw_to_front(forward: Float[np.ndarray, "t 3"]) -> Float[np.ndarray, " t"]:
    """Return the yaw that takes each direction to +Z; 0 for a zero direction."""
    return -np.arctan2(forward[..., 0], forward[..., 2])


def _yaw_matrices(yaw: Float[np.ndarray, " t"]) -> Float[np.ndarray, "t 3 3"]:
    """Make the rotation matrices of yaws about +Y."""
    axes = np.broadcast_to(np.eye(3), (len(yaw), 3, 3))
    return np.swapaxes(rotate_yaw(axes, yaw), -1, -2)


def _wrapped(angles: Float[np.ndarray, " t"]) -> Float[np.ndarray, " t"]:
    """Bring angles into [-pi, pi)."""
    return (angles + np.pi) % (2 * np.pi) - np.pi


def _flat(values: Float[np.ndarray, "t *n"]) -> Float[np.ndarray, "t m"]:
    return values.reshape(len(values), -1)


def _target(choice: np.ndarray | str, skeleton: Skeleton) -> np.ndarray:
    """Resolve "skeleton" to the skeleton's own bone lengths."""
    if not isinstance(choice, str):
        return choice
    if choice != "skeleton":
        raise ValueError(f"target_bone_lengths {choice!r} is neither 'skeleton' nor an array of {skeleton.num_joints}")
    if skeleton.bone_lengths is None:
        raise ValueError(
            f"skeleton {skeleton.name!r} has no published target bone lengths; pass target_bone_lengths as "
            f"{skeleton.num_joints} lengths in {skeleton.unit}, or None to keep the clip's own"
        )
    return skeleton.bone_lengths


def _checked(joints: np.ndarray, skeleton: Skeleton) -> Float[np.ndarray, "t j 3"]:
    """Refuse what has no features; the message names the first offence."""
    joints = np.asarray(joints, dtype=np.float64)
    if joints.ndim != 3 or joints.shape[1:] != (skeleton.num_joints, 3) or len(joints) < 2:
        raise ValueError(
            f"joints have shape {joints.shape}; skeleton {skeleton.name!r} needs (frames >= 2, "
            f"{skeleton.num_joints}, 3)"
        )
    if not np.isfinite(joints).all():
        frame = int(np.argmin(np.isfinite(joints).all((1, 2))))
        raise ValueError(f"joints hold NaN or infinite values from frame {frame} on; leave the clip out or repair it")
    missing = ~bone_vectors(joints, skeleton)[:, 1:].any(-1)
    if missing.any():
        frame, bone = np.argwhere(missing)[0]
        raise ValueError(
            f"the bone that ends at {skeleton.joint_names[bone + 1]!r} has no length in frame {frame}, so no "
            "direction; leave the clip out or repair it"
        )
    return joints

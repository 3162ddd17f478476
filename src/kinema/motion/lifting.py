"""Give essential feature rows their redundant columns again, computed from the joints (HUMANML3D_DATA §3)."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float

from kinema.motion.features import contacts, local_rotations
from kinema.motion.recovery import recover_joints, recover_root
from kinema.motion.rotation import rotate_yaw, sixd_from_matrix
from kinema.motion.skeleton import Skeleton


def lift(features: Float[np.ndarray, "t w"], skeleton: Skeleton) -> Float[np.ndarray, "t d"]:
    """Return full rows of one motion, of which the essential columns are those given, bit by bit.

    Redundant columns that are given are not read. A row's velocities and contacts are those of the step to the next
    frame, so the last row, which has none, repeats the one before. Rotations depend on the heading in the world, which
    here is +Z in the first frame: of a crop from within a clip they differ from the clip's own. Raises ValueError for
    fewer than 2 rows, or rows without the essential columns.
    """
    if len(features) < 2:
        raise ValueError(f"a motion of {len(features)} frames has no velocities; lifting needs at least 2")
    known = features[:, : skeleton.essential_width]
    rows = torch.from_numpy(known.astype(np.float64))
    joints = recover_joints(rows, skeleton).numpy()
    yaw = recover_root(rows)[0].numpy()
    moved = rotate_yaw(np.diff(joints, axis=0), yaw[:-1])
    columns = {
        "rotations": sixd_from_matrix(local_rotations(joints, yaw, skeleton))[:, 1:],
        "velocities": _repeat_last(moved),
        "contacts": _repeat_last(contacts(joints, skeleton)),
    }
    full = np.empty((len(known), skeleton.feature_width), dtype=np.float32)
    full[:, : skeleton.essential_width] = known
    for name, values in columns.items():
        full[:, skeleton.groups[name]] = values.reshape(len(full), -1)
    return full


def _repeat_last(values: np.ndarray) -> np.ndarray:
    return np.concatenate([values, values[-1:]])

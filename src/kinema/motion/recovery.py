"""Turn feature rows back into joint positions (HUMANML3D_DATA §4, MARDM §1); torch, batched, at least float32."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from kinema.motion.rotation import matrix_from_sixd, yaw_matrix
from kinema.motion.skeleton import Skeleton


def recover_root(features: Float[Tensor, "*b t d"]) -> tuple[Float[Tensor, "*b t"], Float[Tensor, "*b t 3"]]:
    """Integrate the root columns into (yaw, position).

    The yaw is the full angle theta_t = 2 sum_{s<t} a_s (radians) that turns the world into the heading frame; row
    t's velocities act on frame t+1, so the last row's go unused.
    """
    root = _at_least_float32(features[..., :4])
    yaw = 2 * _delayed_sum(root[..., 0])
    step = _delayed(root[..., 1:3])
    cos, sin = yaw.cos(), yaw.sin()
    x = (cos * step[..., 0] - sin * step[..., 1]).cumsum(-1)
    z = (sin * step[..., 0] + cos * step[..., 1]).cumsum(-1)
    return yaw, torch.stack([x, root[..., 3], z], dim=-1)


def recover_joints(features: Float[Tensor, "*b t d"], skeleton: Skeleton) -> Float[Tensor, "*b t j 3"]:
    """Place the joints from the essential columns (full rows are fine too); the root comes first.

    Raises ValueError for rows narrower than `skeleton.essential_width`.
    """
    _require_width(features, skeleton.essential_width, "recover_joints", skeleton)
    yaw, root = recover_root(features)
    local = _at_least_float32(features[..., skeleton.groups["joints"]]).unflatten(-1, (-1, 3))
    cos, sin = yaw.cos()[..., None], yaw.sin()[..., None]
    x = cos * local[..., 0] - sin * local[..., 2] + root[..., 0, None]
    z = sin * local[..., 0] + cos * local[..., 2] + root[..., 2, None]
    joints = torch.stack([x, local[..., 1], z], dim=-1)
    return torch.cat([root[..., None, :], joints], dim=-2)


def joints_from_rotations(
    features: Float[Tensor, "*b t d"], skeleton: Skeleton, bone_lengths: np.ndarray | Tensor | None = None
) -> Float[Tensor, "*b t j 3"]:
    """Place the joints by forward kinematics from the 6D rotation columns of full rows.

    `bone_lengths` (J,) default to the skeleton's; every chain starts from the heading (HUMANML3D_DATA §3.9, §4).
    """
    _require_width(features, skeleton.groups["rotations"].stop, "joints_from_rotations", skeleton)
    lengths = skeleton.bone_lengths if bone_lengths is None else bone_lengths
    if lengths is None:
        raise ValueError(
            f"skeleton {skeleton.name!r} has no target bone lengths; pass bone_lengths=(J,) in {skeleton.unit}"
        )
    yaw, root = recover_root(features)
    sixd = _at_least_float32(features[..., skeleton.groups["rotations"]]).unflatten(-1, (-1, 6))
    local = matrix_from_sixd(sixd)
    lengths = lengths.to(local) if isinstance(lengths, Tensor) else _as(lengths, local)
    bones = _as(skeleton.rest_directions, local) * lengths[:, None]
    turned, placed = {0: yaw_matrix(yaw)}, {0: root}
    for chain in skeleton.chains:
        for parent, child in pairwise(chain):
            turned[child] = turned[skeleton.rotation_parents[child]] @ local[..., child - 1, :, :]
            placed[child] = placed[parent] + turned[child] @ bones[child]
    return torch.stack([placed[joint] for joint in range(skeleton.num_joints)], dim=-2)


def _at_least_float32(values: Tensor) -> Tensor:
    """Widen half precision: summed increments drift in it."""
    return values.float() if values.dtype in (torch.float16, torch.bfloat16) else values


def _as(values: np.ndarray, like: Tensor) -> Tensor:
    """Copy an array to the dtype and device of a tensor (cast first: not every device has float64)."""
    return torch.tensor(values, dtype=like.dtype).to(like.device)


def _delayed(values: Float[Tensor, "*b t c"]) -> Float[Tensor, "*b t c"]:
    """Shift by one frame; frame 0 gets zero."""
    return torch.cat([torch.zeros_like(values[..., :1, :]), values[..., :-1, :]], dim=-2)


def _delayed_sum(values: Float[Tensor, "*b t"]) -> Float[Tensor, "*b t"]:
    """Sum everything before each frame."""
    return _delayed(values[..., None])[..., 0].cumsum(-1)


def _require_width(features: Tensor, width: int, caller: str, skeleton: Skeleton) -> None:
    if features.shape[-1] < width:
        raise ValueError(
            f"{caller} needs at least {width} columns for skeleton {skeleton.name!r}, got {features.shape[-1]}; "
            f"essential rows have {skeleton.essential_width}, full rows {skeleton.feature_width}"
        )

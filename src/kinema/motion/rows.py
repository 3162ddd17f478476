"""Turn joint positions into essential feature rows again: the inverse of recovery; torch, batched, at least float32.

The tail of the feature extraction alone (HUMANML3D_DATA §3.6 and on): no other skeleton, floor, place or facing.
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional as F

from kinema.motion.features import HEADING_SIGMA
from kinema.motion.skeleton import Skeleton


def essential_rows(
    joints: Float[Tensor, "b t j 3"], lengths: Int[Tensor, " b"], skeleton: Skeleton
) -> Float[Tensor, "b t d"]:
    """Describe joints (in the skeleton's unit) by root and joint columns; frames past the lengths are zero.

    `recover_joints` gives the joints back, but for where frame 0 stands on the floor: rows take that as the origin and
    its heading as +Z, whatever they are (published so). A row's velocities are those of the step to the next frame, so
    the last row repeats the one before. What lies past a length is not read. Raises ValueError for another number of
    joints.
    """
    if joints.shape[2:] != (skeleton.num_joints, 3):
        raise ValueError(
            f"joints have shape {tuple(joints.shape)}; skeleton {skeleton.name!r} needs (b, t, "
            f"{skeleton.num_joints}, 3)"
        )
    joints = joints.float() if joints.dtype in (torch.float16, torch.bfloat16) else joints
    here = torch.arange(joints.shape[1], device=joints.device)
    joints = _rows(joints, here, lengths - 1)
    yaw = heading(joints, skeleton)
    step = torch.cat((joints[:, 1:, 0] - joints[:, :-1, 0], torch.zeros_like(joints[:, :1, 0])), dim=1)
    ahead = torch.cat((yaw[:, 1:], yaw[:, -1:]), dim=1)
    turn = torch.remainder(ahead - yaw + math.pi, 2 * math.pi) - math.pi
    velocities = torch.cat((turn[..., None] / 2, turned(step, ahead)[..., [0, 2]]), dim=-1)
    floor = joints[:, :, :1] * joints.new_tensor([1, 0, 1])
    local = turned(joints[:, :, 1:] - floor, yaw[..., None]).flatten(2)
    rows = torch.cat((_rows(velocities, here, lengths - 2), joints[:, :, 0, 1:2], local), dim=-1)
    return rows.masked_fill(here[:, None] >= lengths[:, None, None], 0.0)


def heading(joints: Float[Tensor, "b t j 3"], skeleton: Skeleton) -> Float[Tensor, "b t"]:
    """Return the yaw that takes each frame's smoothed forward direction to +Z; 0 at frame 0 (HUMANML3D_DATA §3.6).

    As `motion.features.heading`, the sign of its hip vector included; the last frame is held past the end.
    """
    right_hip, left_hip, right_shoulder, left_shoulder = (joints[:, :, joint] for joint in skeleton.face_joints)
    across = (left_hip - right_hip) + (right_shoulder - left_shoulder)
    across = across / torch.where(across.any(-1), across.norm(dim=-1), 1)[..., None]
    forward = _smoothed(torch.stack((across[..., 2], -across[..., 0]), dim=1))
    yaw = -torch.atan2(forward[:, 0], forward[:, 1])
    return torch.cat((torch.zeros_like(yaw[:, :1]), yaw[:, 1:]), dim=1)


def _smoothed(values: Float[Tensor, "b c t"]) -> Float[Tensor, "b c t"]:
    """Smooth over time by the heading's Gaussian, cut at 4 sigma, the ends held."""
    radius = round(4 * HEADING_SIGMA)
    offsets = torch.arange(-radius, radius + 1, dtype=values.dtype, device=values.device)
    weights = torch.exp(-0.5 * (offsets / HEADING_SIGMA).square())
    held = F.pad(values, (radius, radius), mode="replicate")
    return F.conv1d(held.flatten(0, 1)[:, None], (weights / weights.sum())[None, None]).view_as(values)


def turned(vectors: Float[Tensor, "*b 3"], yaw: Float[Tensor, "*#b"]) -> Float[Tensor, "*b 3"]:
    """Turn vectors about +Y."""
    cos, sin = yaw.cos(), yaw.sin()
    x, y, z = vectors.unbind(-1)
    return torch.stack((cos * x + sin * z, y, cos * z - sin * x), dim=-1)


def _rows(values: Float[Tensor, "b t *c"], here: Int[Tensor, " t"], last: Int[Tensor, " b"]) -> Float[Tensor, "b t *c"]:
    """Hold the last row of each sample that is to be read."""
    index = torch.minimum(here, last.clamp(min=0)[:, None]).view(*values.shape[:2], *[1] * (values.ndim - 2))
    return values.gather(1, index.expand_as(values))

"""Measure how far reconstructed joints and headings are from the originals (METRICS, Definitions)."""

from __future__ import annotations

import math

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torchmetrics import Metric

from kinema.evaluation.metrics.finite import require_finite
from kinema.motion.recovery import recover_joints, recover_root
from kinema.motion.skeleton import Skeleton
from kinema.types import frame_mask


class Reconstruction(Metric):
    """Average joint and heading errors over all real frames.

    mpjpe_mm: distance of root-aligned joints, millimetres whatever the skeleton's unit. mpjpe_heading_mm: the same in
    the heading frame, where drift of the heading does not count. heading_error_deg: angle between the headings.
    """

    is_differentiable, higher_is_better, full_state_update = False, False, False
    world: Tensor
    local: Tensor
    heading: Tensor
    frames: Tensor

    def __init__(self, skeleton: Skeleton, **kwargs: object) -> None:
        super().__init__(**kwargs)
        self.skeleton = skeleton
        for name in ("world", "local", "heading"):
            self.add_state(name, torch.zeros(()), dist_reduce_fx="sum")
        self.add_state("frames", torch.zeros((), dtype=torch.int64), dist_reduce_fx="sum")

    def update(
        self, reconstructed: Float[Tensor, "b t w"], real: Float[Tensor, "b s d"], lengths: Int[Tensor, " b"]
    ) -> None:
        """Add feature rows (essential or full width); frames past the lengths are ignored."""
        size = int(lengths.max())
        reconstructed, real, mask = reconstructed[:, :size], real[:, :size], frame_mask(lengths, size)
        if reconstructed.shape[1] < size:
            raise ValueError(f"the reconstruction has {reconstructed.shape[1]} frames, the original {size}")
        require_finite(reconstructed, "reconstructed features")
        scale = 1000 * self.skeleton.meters
        world = mpjpe(recover_joints(reconstructed, self.skeleton), recover_joints(real, self.skeleton))
        local = mpjpe(heading_joints(reconstructed, self.skeleton), heading_joints(real, self.skeleton))
        turned = recover_root(reconstructed)[0] - recover_root(real)[0]
        off = torch.remainder(turned + math.pi, 2 * math.pi) - math.pi
        self.world += _total(world, mask).to(self.device) * scale
        self.local += _total(local, mask).to(self.device) * scale
        self.heading += _total(off.abs(), mask).to(self.device) * (180 / math.pi)
        self.frames += mask.sum().to(self.device)

    def compute(self) -> dict[str, Tensor]:
        """Return mpjpe_mm, mpjpe_heading_mm and heading_error_deg."""
        return {
            "mpjpe_mm": self.world / self.frames,
            "mpjpe_heading_mm": self.local / self.frames,
            "heading_error_deg": self.heading / self.frames,
        }


def mpjpe(a: Float[Tensor, "*b t j 3"], b: Float[Tensor, "*b t j 3"]) -> Float[Tensor, "*b t"]:
    """Return the mean distance over joints, root included, after moving both roots to the origin."""
    return ((a - a[..., :1, :]) - (b - b[..., :1, :])).norm(dim=-1).mean(-1)


def heading_joints(features: Float[Tensor, "*b t d"], skeleton: Skeleton) -> Float[Tensor, "*b t j 3"]:
    """Return joints in the frame that moves and turns with the root; its height is kept."""
    joints = features[..., skeleton.groups["joints"]].unflatten(-1, (-1, 3))
    height = features[..., skeleton.groups["root_height"]]
    root = torch.cat([torch.zeros_like(height), height, torch.zeros_like(height)], dim=-1)
    return torch.cat([root[..., None, :], joints], dim=-2)


def _total(values: Float[Tensor, "b t"], mask: Bool[Tensor, "b t"]) -> Float[Tensor, ""]:
    return values.masked_fill(~mask, 0).sum()

"""Lead new frames away from the kept ones that an edit puts back beside them."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import torch
from annotated_types import Interval
from jaxtyping import Bool, Float, Int
from torch import Tensor

from kinema.motion.skeleton import Skeleton
from kinema.pipeline.editing import paste
from kinema.types import MotionBatch

BLEND = 0.4
"""Seconds in which new frames leave what was kept: about a step's half."""
Seconds = Annotated[float, Interval(ge=0, le=60)]


def put_back(
    result: MotionBatch,
    source: Float[Tensor, "b t d"],
    keep: Bool[Tensor, "b t"] | Bool[Tensor, "b t d"],
    skeleton: Skeleton,
    seconds: float,
) -> MotionBatch:
    """Put back what an edit keeps, bit by bit, and lead new frames away from it within so many seconds."""
    if frames := round(seconds * skeleton.fps):
        each = keep if keep.ndim == 3 else keep[..., None].expand_as(source)
        result = blended(result, source, each, skeleton.essential_width, frames)
    return paste(result, source, keep)


def blended(
    result: MotionBatch, source: Float[Tensor, "b t d"], keep: Bool[Tensor, "b t d"], columns: int, frames: int
) -> MotionBatch:
    """Move new frames by what the decoding misses of the kept frame before and behind them, fading over `frames`.

    A decoder sees across the border: its own kept frames lead to the new ones smoothly, but not from where the source
    is. Of the source put back alone a joint would leap by that difference. The first `columns` features are moved,
    those that joints are recovered from. Where a new stretch is shorter than `frames`, it fades within the stretch.
    """
    size, width = result.features.shape[1], min(columns, result.features.shape[2])
    keep = keep[:, :size, :width] & result.mask[..., None]
    made = result.features[..., :width]
    missed = torch.where(keep, source[:, :size, :width] - made, 0)
    before, behind = _nearest_before(keep), size - 1 - _nearest_before(keep.flip(1)).flip(1)
    gap = torch.where((before >= 0) & (behind < size), behind - before, frames).clamp(1, frames)
    here = torch.arange(size, device=made.device)[:, None]
    moved = made
    for nearest, there in ((before, before >= 0), (behind, behind < size)):
        share = torch.where(there & result.mask[..., None], 1 - (here - nearest).abs() / gap, 0).clamp(min=0)
        eased = share.square() * (3 - 2 * share)
        moved = moved + eased * missed.gather(1, nearest.clamp(0, size - 1))
    return replace(result, features=torch.cat((moved, result.features[..., width:]), dim=-1))


def _nearest_before(keep: Bool[Tensor, "b t d"]) -> Int[Tensor, "b t d"]:
    """Return the last kept frame at or before each, -1 where there is none."""
    here = torch.arange(keep.shape[1], device=keep.device)[:, None]
    return torch.where(keep, here, -1).cummax(dim=1).values

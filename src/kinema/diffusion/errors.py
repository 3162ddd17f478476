"""Average the errors of padded sequences over what is real: by sequence, or by frame."""

from __future__ import annotations

from jaxtyping import Bool, Float
from torch import Tensor


def per_sequence(errors: Float[Tensor, "b t *d"], mask: Bool[Tensor, "b t"]) -> Float[Tensor, " b"]:
    """Average over each sequence's real frames and their dims: short ones weigh as much as long ones (MDM §3)."""
    frames = errors.flatten(2).mean(dim=2).masked_fill(~mask, 0.0)
    return frames.sum(dim=1) / mask.sum(dim=1).clamp(min=1)


def per_frame(errors: Float[Tensor, "b t *d"], mask: Bool[Tensor, "b t"]) -> Float[Tensor, " m"]:
    """Average over the dims of each real frame; their mean weighs sequences by length (MotionDiffuse)."""
    return errors.flatten(2).mean(dim=2)[mask]

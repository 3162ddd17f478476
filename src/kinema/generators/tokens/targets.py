"""Put END behind sequences of codes, and average over codes and END."""

from __future__ import annotations

from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional as F

from kinema.types import frame_mask


def targets(codes: Int[Tensor, "b n"], lengths: Int[Tensor, " b"], end: int, pad: int) -> Int[Tensor, "b m"]:
    """Return the codes, END behind the last one and PAD behind that, one position more than the codes have."""
    real = frame_mask(lengths, codes.shape[1] + 1)
    filled = F.pad(codes, (0, 1)).masked_fill(~real, pad)
    return filled.scatter(1, lengths[:, None], end)


def per_sample(values: Float[Tensor, "b m"], lengths: Int[Tensor, " b"]) -> Float[Tensor, " b"]:
    """Average each sample's values over its codes and its END."""
    counted = frame_mask(lengths + 1, values.shape[1])
    return values.masked_fill(~counted, 0.0).sum(dim=1) / (lengths + 1)

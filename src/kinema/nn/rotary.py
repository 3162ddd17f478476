"""Turn queries and keys by their positions (rotary position embedding, Su et al. 2021)."""

from __future__ import annotations

import torch
from jaxtyping import Float, Shaped
from torch import Tensor


def rotary(x: Float[Tensor, "m h d"], positions: Shaped[Tensor, " m"], base: float = 10000.0) -> Float[Tensor, "m h d"]:
    """Turn each interleaved pair of channels by position * base^(-pair / pairs); products see differences alone."""
    pairs = x.shape[-1] // 2
    frequency = base ** (-torch.arange(pairs, device=x.device, dtype=torch.float32) / pairs)
    angle = (positions.to(x.device, torch.float32)[:, None] * frequency)[:, None]
    cos, sin = angle.cos().to(x.dtype), angle.sin().to(x.dtype)
    swapped = x.unflatten(-1, (pairs, 2)).flip(-1).flatten(-2)  # (even, odd) cos + (odd, even) (-sin, sin)
    return x * cos.repeat_interleave(2, dim=-1) + swapped * torch.stack((-sin, sin), dim=-1).flatten(-2)

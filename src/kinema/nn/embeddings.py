"""Embed positions and diffusion times by sinusoids, computed where they are used (no buffers to save)."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float, Shaped
from torch import Tensor


def sinusoidal_positions(
    length: int, width: int, device: torch.device | str | None = None
) -> Float[Tensor, "length width"]:
    """Make the interleaved table: sin on even, cos on odd channels, base 10000, positions 0..length-1."""
    return interleaved_embedding(torch.arange(length, device=device), width)


def interleaved_embedding(time: Shaped[Tensor, " n"], width: int) -> Float[Tensor, "n width"]:
    """Embed times as rows of the interleaved table, which need not be whole numbers."""
    frequency = torch.exp(torch.arange(0, width, 2, device=time.device) * (-math.log(10000.0) / width))
    angle = time[:, None] * frequency
    return torch.stack((angle.sin(), angle.cos()), dim=-1).flatten(1)[:, :width]


def timestep_embedding(time: Shaped[Tensor, " n"], width: int = 256) -> Float[Tensor, "n width"]:
    """Embed times as [cos(t f_i), sin(t f_i)], f_i = 10000^(-i / (width/2)) (MARDM §5; the time enters unscaled)."""
    half = width // 2
    frequency = torch.exp(torch.arange(half, device=time.device) * (-math.log(10000.0) / half))
    angle = time.float()[:, None] * frequency
    return torch.cat((angle.cos(), angle.sin()), dim=-1)

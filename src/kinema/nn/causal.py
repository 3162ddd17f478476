"""Convolve along time so that nothing sees what comes later (FRONTIER §3): the result needs no lengths.

Columns of a sequence, such as the joints of a body, go through as a batch: none sees another.
"""

from __future__ import annotations

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn


class CausalConv(nn.Conv1d):
    """Pad on the left alone, with zeros; of `stride` frames an output sees the last one too."""

    def __init__(self, inputs: int, outputs: int, kernel: int, *, stride: int = 1, dilation: int = 1) -> None:
        super().__init__(inputs, outputs, kernel, stride=stride, dilation=dilation)
        self.past = dilation * (kernel - 1) - (stride - 1)

    def forward(self, x: Float[Tensor, "b c t"]) -> Float[Tensor, "b d n"]:
        return super().forward(F.pad(x, (self.past, 0)))


class CausalBlock(nn.Module):
    """Add a dilated convolution of the activated input to the input.

    Nothing else is activated, so that a way through the whole net is linear: where joints stand goes through at once.
    """

    def __init__(self, width: int, dilation: int, dropout: float) -> None:
        super().__init__()
        self.wide = CausalConv(width, width, 3, dilation=dilation)
        self.point = nn.Conv1d(width, width, 1)
        self.dropout = nn.Dropout(dropout)

    def forward(self, x: Float[Tensor, "b c t"]) -> Float[Tensor, "b c t"]:
        return x + self.dropout(self.point(F.silu(self.wide(F.silu(x)))))


def _stack(width: int, depth: int, growth: int, dropout: float) -> nn.Sequential:
    """Chain `depth` blocks, the largest dilation first."""
    return nn.Sequential(*(CausalBlock(width, growth**i, dropout) for i in reversed(range(depth))))


class CausalEncoder(nn.Module):
    """Halve the time axis `levels` times; a latent sees its own frames and those before."""

    def __init__(
        self, inputs: int, outputs: int, *, width: int, levels: int, depth: int, growth: int, dropout: float
    ) -> None:
        super().__init__()
        self.stem = CausalConv(inputs, width, 3)
        self.down = nn.ModuleList(CausalConv(width, width, 4, stride=2) for _ in range(levels))
        self.stacks = nn.ModuleList(_stack(width, depth, growth, dropout) for _ in range(levels))
        self.head = CausalConv(width, outputs, 3)

    def forward(self, x: Float[Tensor, "b c t"]) -> Float[Tensor, "b d n"]:
        x = self.stem(x)
        for down, stack in zip(self.down, self.stacks, strict=True):
            x = stack(down(x))
        return self.head(x)


class CausalDecoder(nn.Module):
    """Double the time axis `levels` times; a frame sees its own latent and those before."""

    def __init__(
        self, inputs: int, outputs: int, *, width: int, levels: int, depth: int, growth: int, dropout: float
    ) -> None:
        super().__init__()
        self.stem = CausalConv(inputs, width, 3)
        self.stacks = nn.ModuleList(_stack(width, depth, growth, dropout) for _ in range(levels))
        self.up = nn.ModuleList(CausalConv(width, width, 3) for _ in range(levels))
        self.head = CausalConv(width, outputs, 3)

    def forward(self, z: Float[Tensor, "b c n"]) -> Float[Tensor, "b d t"]:
        x = self.stem(z)
        for stack, up in zip(self.stacks, self.up, strict=True):
            x = up(F.interpolate(stack(x), scale_factor=2.0, mode="nearest"))
        return self.head(x)

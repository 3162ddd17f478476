"""Encode and decode sequences with the strided 1-D convolutions that every published motion tokenizer shares.

Source: MARDM §3, COMMON §3 (T2M-GPT, MoMask, MMM, BAD, BAMM, AttT2M: the same net, other widths and dropout).
Lengths are optional: with them, what lies past a sample's end is zeroed before every convolution that looks sideways,
so that the result is that of the sample alone. Without them a batch is taken as full.
"""

from __future__ import annotations

import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from kinema.types import frame_mask


class ResidualBlock(nn.Module):
    """Add a dilated convolution of the pre-activated input to the input."""

    def __init__(self, width: int, dilation: int, dropout: float) -> None:
        super().__init__()
        self.wide = nn.Conv1d(width, width, 3, padding=dilation, dilation=dilation)
        self.point = nn.Conv1d(width, width, 1)
        self.dropout = nn.Dropout(dropout)

    def forward(self, x: Float[Tensor, "b c t"], lengths: Int[Tensor, " b"] | None = None) -> Float[Tensor, "b c t"]:
        hidden = F.relu(self.wide(F.relu(zero_past(x, lengths))))
        return x + self.dropout(self.point(hidden))


class ResidualStack(nn.Module):
    """Apply `depth` residual blocks, the largest dilation first (9, 3, 1 for depth 3 and growth 3)."""

    def __init__(self, width: int, depth: int, growth: int, dropout: float) -> None:
        super().__init__()
        self.blocks = nn.ModuleList(ResidualBlock(width, growth**i, dropout) for i in reversed(range(depth)))

    def forward(self, x: Float[Tensor, "b c t"], lengths: Int[Tensor, " b"] | None = None) -> Float[Tensor, "b c t"]:
        for block in self.blocks:
            x = block(x, lengths)
        return x


class ConvEncoder(nn.Module):
    """Halve the time axis `levels` times: (b, t, input_dim) -> (b, t // 2**levels, latent_dim)."""

    def __init__(
        self,
        input_dim: int,
        latent_dim: int,
        *,
        width: int = 512,
        levels: int = 2,
        depth: int = 3,
        dilation_growth: int = 3,
        dropout: float = 0.0,
    ) -> None:
        super().__init__()
        self.stem = nn.Conv1d(input_dim, width, 3, padding=1)
        self.down = nn.ModuleList(nn.Conv1d(width, width, 4, stride=2, padding=1) for _ in range(levels))
        self.stacks = nn.ModuleList(ResidualStack(width, depth, dilation_growth, dropout) for _ in range(levels))
        self.head = nn.Conv1d(width, latent_dim, 3, padding=1)

    def forward(self, x: Float[Tensor, "b t d"], lengths: Int[Tensor, " b"] | None = None) -> Float[Tensor, "b n c"]:
        x = F.relu(self.stem(zero_past(x.transpose(1, 2), lengths)))
        for down, stack in zip(self.down, self.stacks, strict=True):
            x = down(zero_past(x, lengths))
            lengths = None if lengths is None else lengths // 2
            x = stack(x, lengths)
        x = self.head(zero_past(x, lengths))
        return zero_past(x, lengths).transpose(1, 2)


class ConvDecoder(nn.Module):
    """Double the time axis `levels` times: (b, n, latent_dim) -> (b, n * 2**levels, output_dim)."""

    def __init__(
        self,
        latent_dim: int,
        output_dim: int,
        *,
        width: int = 512,
        levels: int = 2,
        depth: int = 3,
        dilation_growth: int = 3,
        dropout: float = 0.0,
    ) -> None:
        super().__init__()
        self.stem = nn.Conv1d(latent_dim, width, 3, padding=1)
        self.stacks = nn.ModuleList(ResidualStack(width, depth, dilation_growth, dropout) for _ in range(levels))
        self.up = nn.ModuleList(nn.Conv1d(width, width, 3, padding=1) for _ in range(levels))
        self.mix = nn.Conv1d(width, width, 3, padding=1)
        self.head = nn.Conv1d(width, output_dim, 3, padding=1)

    def forward(self, z: Float[Tensor, "b n c"], lengths: Int[Tensor, " b"] | None = None) -> Float[Tensor, "b t d"]:
        x = F.relu(self.stem(zero_past(z.transpose(1, 2), lengths)))
        for stack, up in zip(self.stacks, self.up, strict=True):
            x = F.interpolate(stack(x, lengths), scale_factor=2.0, mode="nearest")
            lengths = None if lengths is None else lengths * 2
            x = up(zero_past(x, lengths))
        x = F.relu(self.mix(zero_past(x, lengths)))
        x = self.head(zero_past(x, lengths))
        return zero_past(x, lengths).transpose(1, 2)


def zero_past(x: Float[Tensor, "b c t"], lengths: Int[Tensor, " b"] | None) -> Float[Tensor, "b c t"]:
    """Zero what lies past each length; return `x` itself where no lengths are given."""
    if lengths is None:
        return x
    return x.masked_fill(~frame_mask(lengths, x.shape[-1])[:, None], 0.0)

"""Condition blocks by adaptive layer norm (adaLN-zero): shift, scale and gate are read from a condition vector."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from kinema.nn.attention import Attention
from kinema.nn.heads import CrossAttention
from kinema.nn.rows import Rows


def modulate(x: Float[Tensor, "*b w"], shift: Float[Tensor, "*#b w"], scale: Float[Tensor, "*#b w"]) -> Tensor:
    """Shift and scale normalised features."""
    return x * (1 + scale) + shift


class AdaLNBlock(nn.Module):
    """Transformer block whose two layer norms are modulated, and whose two branches are gated, by a condition vector.

    The modulation starts at zero, so that an untrained block is the identity (MARDM §4). `cross` adds, between the
    branches, attention to a context (FRONTIER §9.2), closed at the start too.
    """

    def __init__(self, width: int, heads: int, feedforward: int, dropout: float = 0.0, *, cross: bool = False) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width, eps=1e-6, elementwise_affine=False)
        self.attention = Attention(width, heads, dropout)
        self.mlp = nn.Sequential(
            nn.Linear(width, feedforward), nn.GELU(approximate="tanh"), nn.Linear(feedforward, width)
        )
        read = nn.Linear(width, 6 * width)
        nn.init.zeros_(read.weight)
        nn.init.zeros_(read.bias)
        self.modulation = nn.Sequential(nn.SiLU(), read)
        self.cross = CrossAttention(width, heads) if cross else None

    def close(self) -> None:
        """Close what reads the context, as it starts."""
        if self.cross is not None:
            self.cross.close()

    def forward(
        self,
        x: Float[Tensor, "b n w"],
        condition: Float[Tensor, "b w"],
        mask: Bool[Tensor, "b n"] | None = None,
        context: Float[Tensor, "b l w"] | None = None,
        context_mask: Bool[Tensor, "b l"] | None = None,
    ) -> Float[Tensor, "b n w"]:
        """Attend over the positions, and over those of a context, that the masks show (True = real)."""
        shift1, scale1, gate1, shift2, scale2, gate2 = self.modulation(condition)[:, None].chunk(6, dim=-1)
        x = x + gate1 * self.attention(modulate(self.norm(x), shift1, scale1), mask)
        if self.cross is not None and context is not None:
            rows, others = (
                Rows(torch.ones_like(held[..., 0], dtype=torch.bool) if shown is None else shown)
                for held, shown in ((x, mask), (context, context_mask))
            )
            held = self.cross.read(others.pack(context), others)
            x = x + rows.pad(self.cross(rows.pack(x), rows, held, others.real))
        return x + gate2 * self.mlp(modulate(self.norm(x), shift2, scale2))

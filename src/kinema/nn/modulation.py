"""Condition blocks by adaptive layer norm (adaLN-zero): shift, scale and gate are read from a condition vector."""

from __future__ import annotations

from jaxtyping import Bool, Float
from torch import Tensor, nn

from kinema.nn.attention import Attention


def modulate(x: Float[Tensor, "*b w"], shift: Float[Tensor, "*#b w"], scale: Float[Tensor, "*#b w"]) -> Tensor:
    """Shift and scale normalised features."""
    return x * (1 + scale) + shift


class AdaLNBlock(nn.Module):
    """Transformer block whose two layer norms are modulated, and whose two branches are gated, by a condition vector.

    The modulation starts at zero, so that an untrained block is the identity (MARDM §4).
    """

    def __init__(self, width: int, heads: int, feedforward: int, dropout: float = 0.0) -> None:
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

    def forward(
        self, x: Float[Tensor, "b n w"], condition: Float[Tensor, "b w"], mask: Bool[Tensor, "b n"] | None = None
    ) -> Float[Tensor, "b n w"]:
        """Attend over the positions that `mask` shows (True = real)."""
        shift1, scale1, gate1, shift2, scale2, gate2 = self.modulation(condition)[:, None].chunk(6, dim=-1)
        x = x + gate1 * self.attention(modulate(self.norm(x), shift1, scale1), mask)
        return x + gate2 * self.mlp(modulate(self.norm(x), shift2, scale2))

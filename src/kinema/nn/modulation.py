"""Condition blocks by adaptive layer norm (adaLN-zero): shift, scale and gate are read from a condition vector."""

from __future__ import annotations

from jaxtyping import Float
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
        x: Float[Tensor, "m w"],
        rows: Rows,
        condition: Float[Tensor, "b w"],
        context: Float[Tensor, "l w"] | None = None,
        words: Rows | None = None,
    ) -> Float[Tensor, "m w"]:
        """Attend over the `rows` of each sequence, and over those of its context, whose rows are `words`."""
        shift1, scale1, gate1, shift2, scale2, gate2 = rows.spread(self.modulation(condition)).chunk(6, dim=-1)
        x = x + gate1 * self.attention(modulate(self.norm(x), shift1, scale1), rows=rows)
        if self.cross is not None and context is not None and words is not None:
            x = x + self.cross(x, rows, self.cross.read(context, words), words.real)
        return x + gate2 * self.mlp(modulate(self.norm(x), shift2, scale2))

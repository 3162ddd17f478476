"""Split positions into heads whose queries and keys are normalised, and may be turned by their place."""

from __future__ import annotations

from jaxtyping import Bool, Float, Shaped
from torch import Tensor, nn
from torch.nn import functional as F

from kinema.nn.rotary import rotary

Heads = tuple[Float[Tensor, "b h n d"], Float[Tensor, "b h n d"], Float[Tensor, "b h n d"]]
"""Queries, keys and values of one stream."""
Across = tuple[Float[Tensor, "b h n d"], Float[Tensor, "b h l d"], Float[Tensor, "b h l d"]]
"""Queries of one stream, keys and values of another."""


class Projections(nn.Module):
    """Make one stream's queries, keys and values, and its output (FRONTIER §2.2): RMSNorm on queries and keys."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        if width % heads or width // heads % 2:
            raise ValueError(
                f"width {width} over {heads} heads gives no even number of channels a head; choose heads that divide "
                "the width into even parts"
            )
        self.heads = heads
        self.qkv = nn.Linear(width, 3 * width, bias=False)
        self.query_norm = nn.RMSNorm(width // heads, eps=1e-6)
        self.key_norm = nn.RMSNorm(width // heads, eps=1e-6)
        self.proj = nn.Linear(width, width)

    def split(
        self, x: Float[Tensor, "b n w"], positions: Shaped[Tensor, " n"] | None = None, base: float = 10000.0
    ) -> Heads:
        """Project, normalise queries and keys, and turn them by their `positions` (None: they have none)."""
        query, key, value = self._heads(x, 0, 3)
        query, key = self.query_norm(query), self.key_norm(key)
        if positions is not None:
            query, key = rotary(query, positions, base), rotary(key, positions, base)
        return query, key, value

    def across(self, x: Float[Tensor, "b n w"], context: Float[Tensor, "b l w"]) -> Across:
        """Make queries of `x`, keys and values of the context."""
        (query,), (key, value) = self._heads(x, 0, 1), self._heads(context, 1, 3)
        return self.query_norm(query), self.key_norm(key), value

    def _heads(self, x: Tensor, start: int, end: int) -> Float[Tensor, "k b h n d"]:
        width = x.shape[-1]
        rows = F.linear(x, self.qkv.weight[start * width : end * width])
        return rows.unflatten(-1, (end - start, self.heads, -1)).permute(2, 0, 3, 1, 4)

    def join(self, attended: Float[Tensor, "b h n d"]) -> Float[Tensor, "b n w"]:
        """Lay the heads side by side and project."""
        return self.proj(attended.transpose(1, 2).flatten(2))


class CrossAttention(nn.Module):
    """Normalise positions and attend to a context; closed at the start."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.norm = nn.RMSNorm(width, eps=1e-6)
        self.attention = Projections(width, heads)
        self.close()

    def close(self) -> None:
        """Start at no effect."""
        nn.init.zeros_(self.attention.proj.weight)
        nn.init.zeros_(self.attention.proj.bias)

    def forward(
        self, x: Float[Tensor, "b n w"], context: Float[Tensor, "b l w"], mask: Bool[Tensor, "b l"] | None = None
    ) -> Float[Tensor, "b n w"]:
        """Read the positions of the context that `mask` shows (True = real)."""
        heads = self.attention.across(self.norm(x), context)
        mask = None if mask is None else mask[:, None, None]
        return self.attention.join(F.scaled_dot_product_attention(*heads, attn_mask=mask))

"""Split rows into heads whose queries and keys are normalised, and may be turned by their place."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional as F

from kinema.nn.norms import RMSNorm
from kinema.nn.rotary import rotary
from kinema.nn.rows import Rows

Heads = tuple[Float[Tensor, "m h d"], Float[Tensor, "m h d"], Float[Tensor, "m h d"]]
"""Queries, keys and values."""


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
        self.query_norm = RMSNorm(width // heads)
        self.key_norm = RMSNorm(width // heads)
        self.proj = nn.Linear(width, width)

    def split(self, x: Float[Tensor, "m w"], rows: Rows, *, base: float | None = None) -> Heads:
        """Project, normalise queries and keys, and turn them by their place in a rotary of `base` (None: not)."""
        query, key, value = self._heads(x, 0, 3)
        query, key = self.query_norm(query), self.key_norm(key)
        if base is not None:
            query, key = rotary(query, rows.place, base), rotary(key, rows.place, base)
        return query, key, value

    def held(self, context: Float[Tensor, "m w"], others: Rows) -> Float[Tensor, "b l k"]:
        """Make the keys and values of a context, side by side, padded."""
        key, value = self._heads(context, 1, 3)
        return others.pad(torch.cat((self.key_norm(key), value), dim=1).flatten(1))

    def across(
        self, x: Float[Tensor, "m w"], rows: Rows, held: Float[Tensor, "b l e"], seen: Bool[Tensor, "b l"]
    ) -> Float[Tensor, "m w"]:
        """Attend to those of a context that it holds and that are seen."""
        (query,) = self._heads(x, 0, 1)
        query = rows.pad(self.query_norm(query)).transpose(1, 2)
        key, value = held.unflatten(-1, (2, self.heads, -1)).permute(2, 0, 3, 1, 4)
        attended = F.scaled_dot_product_attention(query, key, value, attn_mask=seen[:, None, None])
        return self.join(rows.pack(attended.transpose(1, 2)))

    def join(self, attended: Float[Tensor, "m h d"]) -> Float[Tensor, "m w"]:
        """Lay the heads of each row side by side and project."""
        return self.proj(attended.flatten(1))

    def _heads(self, x: Tensor, start: int, end: int) -> tuple[Float[Tensor, "m h d"], ...]:
        width = x.shape[-1]
        found = F.linear(x, self.qkv.weight[start * width : end * width])
        return found.unflatten(-1, (end - start, self.heads, -1)).unbind(1)


class CrossAttention(nn.Module):
    """Normalise rows and attend to a context; closed at the start.

    What rows ask of the context doesn't depend on them: `read` makes it once for all that attend to it.
    """

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.norm = RMSNorm(width)
        self.attention = Projections(width, heads)
        self.close()

    def close(self) -> None:
        """Start at no effect."""
        nn.init.zeros_(self.attention.proj.weight)
        nn.init.zeros_(self.attention.proj.bias)

    def read(self, context: Float[Tensor, "m w"], others: Rows) -> Float[Tensor, "b l k"]:
        """Return the keys and values of a context."""
        return self.attention.held(context, others)

    def forward(
        self, x: Float[Tensor, "m w"], rows: Rows, held: Float[Tensor, "b l e"], seen: Bool[Tensor, "b l"]
    ) -> Float[Tensor, "m w"]:
        """Attend to those of a context that `read` made, where `seen` shows them."""
        return self.attention.across(self.norm(x), rows, held, seen)

"""Attend and transform with styles: a branch's result is scaled and shifted by an embedding of time and text.

Source: MotionDiffuse (ReMoDiffuse has the same). A branch starts at zero, so that an untrained block is the identity.
"""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional as F

from kinema.nn.attention import attend_within
from kinema.nn.modulation import modulate
from kinema.nn.rows import Rows

ATTENTIONS = ("linear", "softmax")
HIDDEN = -1e6
"""The keys of what is masked, before their softmax over time."""


class Stylization(nn.Module):
    """Modulate normalised features by an embedding, then project them."""

    def __init__(self, width: int, embedding: int, dropout: float = 0.0) -> None:
        super().__init__()
        self.modulation = nn.Linear(embedding, 2 * width)
        self.norm = nn.LayerNorm(width)
        self.dropout = nn.Dropout(dropout)
        self.output = nn.Linear(width, width)
        nn.init.zeros_(self.output.weight)
        nn.init.zeros_(self.output.bias)

    def forward(self, h: Float[Tensor, "m w"], rows: Rows, embedding: Float[Tensor, "b e"]) -> Float[Tensor, "m w"]:
        scale, shift = rows.spread(self.modulation(F.silu(embedding))).chunk(2, dim=-1)
        return self.output(self.dropout(F.silu(modulate(self.norm(h), shift, scale))))


class StylizedAttention(nn.Module):
    """Add what attention to oneself, or to a context of `context_dim` channels, finds, stylised.

    "linear" (efficient) attention takes softmax over the channels of the queries and over time of the keys, "softmax"
    is the usual one with dropout on its probabilities.
    """

    def __init__(
        self,
        width: int,
        heads: int,
        embedding: int,
        *,
        context_dim: int | None = None,
        attention: str = "linear",
        dropout: float = 0.0,
    ) -> None:
        super().__init__()
        if width % heads:
            raise ValueError(f"width {width} is not a multiple of heads {heads}; choose heads that divide the width")
        if attention not in ATTENTIONS:
            raise ValueError(f"attention {attention!r} is unknown; choose one of {', '.join(ATTENTIONS)}")
        self.heads, self.dropout, self.linear = heads, dropout, attention == "linear"
        self.norm = nn.LayerNorm(width)
        self.context_norm = nn.Identity() if context_dim is None else nn.LayerNorm(context_dim)
        self.query = nn.Linear(width, width)
        self.key = nn.Linear(context_dim or width, width)
        self.value = nn.Linear(context_dim or width, width)
        self.style = Stylization(width, embedding, dropout)

    def forward(
        self,
        x: Float[Tensor, "m w"],
        rows: Rows,
        embedding: Float[Tensor, "b e"],
        context: Float[Tensor, "b k c"] | None = None,
        seen: Bool[Tensor, "b k"] | None = None,
    ) -> Float[Tensor, "m w"]:
        """Attend to the rows of one's own sequence, or to what of its context is `seen` (None: all)."""
        own = self.norm(x)
        source = own if context is None else self.context_norm(context)
        query, key, value = (
            layer(part).unflatten(-1, (self.heads, -1))
            for layer, part in ((self.query, own), (self.key, source), (self.value, source))
        )
        dropout = self.dropout if self.training else 0.0
        if context is None and not self.linear:
            attended = attend_within(query, key, value, rows, dropout=dropout)
            return x + self.style(attended.flatten(1), rows, embedding)
        if context is None:
            key, value, seen = rows.pad(key), rows.pad(value), None if rows.whole else rows.real
        query, key, value = (part.transpose(1, 2) for part in (rows.pad(query), key, value))
        shown = None if seen is None else seen[:, None]
        if self.linear:
            attended = linear_attention(query, key, value, shown)
        else:
            pairs = None if shown is None else shown[:, :, None]
            attended = F.scaled_dot_product_attention(query, key, value, attn_mask=pairs, dropout_p=dropout)
        return x + self.style(rows.pack(attended.transpose(1, 2)).flatten(1), rows, embedding)


class StylizedFeedForward(nn.Module):
    """Add what two layers make of each position, stylised; they start at zero."""

    def __init__(self, width: int, feedforward: int, embedding: int, dropout: float = 0.0) -> None:
        super().__init__()
        last = nn.Linear(feedforward, width)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        self.mlp = nn.Sequential(nn.Linear(width, feedforward), nn.GELU(), nn.Dropout(dropout), last)
        self.style = Stylization(width, embedding, dropout)

    def forward(self, x: Float[Tensor, "m w"], rows: Rows, embedding: Float[Tensor, "b e"]) -> Float[Tensor, "m w"]:
        return x + self.style(self.mlp(x), rows, embedding)


def linear_attention(
    query: Float[Tensor, "b h t d"],
    key: Float[Tensor, "b h k d"],
    value: Float[Tensor, "b h k d"],
    mask: Bool[Tensor, "b #h k"] | None = None,
) -> Float[Tensor, "b h t d"]:
    """Attend in time linear in the lengths: softmax_d(q) (softmax_k(k)^T v); what `mask` hides has no weight."""
    if mask is not None:
        hidden = ~mask[..., None]
        key, value = key.masked_fill(hidden, max(HIDDEN, torch.finfo(key.dtype).min)), value.masked_fill(hidden, 0.0)
    return query.softmax(-1) @ (key.softmax(-2).mT @ value)

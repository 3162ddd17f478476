"""Attend over sequences: one multi-head module for self- and cross-attention, with a key-value cache."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional as F

from kinema.nn.rows import Rows


class KeyValueCache:
    """Keep one attention layer's keys and values of the positions seen so far, at most `size`."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.length = 0
        self.keys: Tensor | None = None
        self.values: Tensor | None = None

    def append(self, keys: Float[Tensor, "b h n d"], values: Float[Tensor, "b h n d"]) -> tuple[Tensor, Tensor]:
        """Add new positions and give all; raises ValueError beyond `size`."""
        if self.keys is None or self.values is None:
            shape = (*keys.shape[:2], self.size, keys.shape[3])
            self.keys, self.values = keys.new_empty(shape), values.new_empty(shape)
        end = self.length + keys.shape[2]
        if end > self.size:
            raise ValueError(f"a cache of {self.size} positions cannot take {end}; make it larger")
        self.keys[:, :, self.length : end] = keys
        self.values[:, :, self.length : end] = values
        self.length = end
        return self.keys[:, :, :end], self.values[:, :, :end]


class Attention(nn.Module):
    """Multi-head attention with separate biased query, key, value and output projections.

    Dropout acts on the attention probabilities and on the projected output.
    """

    def __init__(self, width: int, heads: int, dropout: float = 0.0) -> None:
        super().__init__()
        if width % heads:
            raise ValueError(f"width {width} is not a multiple of heads {heads}; choose heads that divide the width")
        self.heads = heads
        self.dropout = dropout
        self.query = nn.Linear(width, width)
        self.key = nn.Linear(width, width)
        self.value = nn.Linear(width, width)
        self.proj = nn.Linear(width, width)

    def forward(
        self,
        x: Float[Tensor, "*q w"],
        mask: Bool[Tensor, "..."] | None = None,
        context: Float[Tensor, "b k w"] | None = None,
        cache: KeyValueCache | None = None,
        rows: Rows | None = None,
    ) -> Float[Tensor, "*q w"]:
        """Attend from `x` to `context` (itself by default); `mask`, True = may be seen, broadcasts to (b, heads, q, k).

        A mask over keys alone has the shape (b, k); one over pairs (b, q, k) or (b, heads, q, k). With a `cache` (self-
        attention) the keys are all positions it holds, those of `x` appended; a query that is refused every key gets
        zeros before the output projection.
        With `rows`, `x` (m w) has those of a batch and each attends to its own sequence, all of it or what a mask over
        padded positions shows; there is no cache then.
        """
        if rows is not None and cache is not None:
            raise ValueError("a cache holds positions of padded sequences; give it without rows")
        if mask is not None and mask.ndim < 4:
            mask = mask[:, None, None, :] if mask.ndim == 2 else mask[:, None]
        source = x if context is None else context
        query, key, value = (
            layer(part).unflatten(-1, (self.heads, -1))
            for layer, part in ((self.query, x), (self.key, source), (self.value, source))
        )
        dropout = self.dropout if self.training else 0.0
        if rows is not None and context is None:
            attended = attend_within(query, key, value, rows, mask, dropout)
        else:
            query = query if rows is None else rows.pad(query)
            query, key, value = (part.transpose(1, 2) for part in (query, key, value))
            if cache is not None:
                key, value = cache.append(key, value)
            attended = F.scaled_dot_product_attention(query, key, value, attn_mask=mask, dropout_p=dropout)
            attended = attended.transpose(1, 2) if rows is None else rows.pack(attended.transpose(1, 2))
        return F.dropout(self.proj(attended.flatten(-2)), dropout)


LONG = 32
"""Positions from which on a CPU is faster at one sequence after the other than at padded ones."""


def attend_within(
    query: Float[Tensor, "m h d"],
    key: Float[Tensor, "m h d"],
    value: Float[Tensor, "m h d"],
    rows: Rows,
    mask: Bool[Tensor, "b #h #n n"] | None = None,
    dropout: float = 0.0,
) -> Float[Tensor, "m h d"]:
    """Attend to the rows of one's own sequence, all of them or those that `mask`, over padded positions, shows."""
    if mask is None and not rows.whole and query.is_cpu and rows.real.shape[1] >= LONG:
        return _one_by_one(query, key, value, rows, dropout)
    if not rows.whole:
        real = rows.real[:, None, None]
        mask = real if mask is None else mask & real
    query, key, value = (rows.pad(part).transpose(1, 2) for part in (query, key, value))
    attended = F.scaled_dot_product_attention(query, key, value, attn_mask=mask, dropout_p=dropout)
    return rows.pack(attended.transpose(1, 2))


def _one_by_one(
    query: Float[Tensor, "m h d"],
    key: Float[Tensor, "m h d"],
    value: Float[Tensor, "m h d"],
    rows: Rows,
    dropout: float,
) -> Float[Tensor, "m h d"]:
    """Start a kernel for each sequence, which costs a CPU little: half of the time over padding where they are long."""
    sequences = (part.transpose(0, 1)[None].split(rows.counts, dim=2) for part in (query, key, value))
    found = [F.scaled_dot_product_attention(q, k, v, dropout_p=dropout) for q, k, v in zip(*sequences, strict=True)]
    return torch.cat(found, dim=2)[0].transpose(0, 1)

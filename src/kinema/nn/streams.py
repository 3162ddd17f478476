"""Let streams of positions attend to each other: rotary heads with normalised queries and keys, modulated blocks."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float, Shaped
from torch import Tensor, nn
from torch.nn import functional as F

from kinema.nn.modulation import modulate
from kinema.nn.rotary import rotary
from kinema.nn.swiglu import SwiGLU

Heads = tuple[Float[Tensor, "b h n d"], Float[Tensor, "b h n d"], Float[Tensor, "b h n d"]]
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

    def across(self, x: Float[Tensor, "b n w"], context: Float[Tensor, "b l w"]) -> Heads:
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


class Modulation(nn.Module):
    """Read `count` shifts, scales and gates of a condition; zero at the start, so that an untrained block is no change.

    With `shared`, which all blocks have one of, the block adds an offset of its own to what it reads (PixArt's
    adaLN-single): modulation is two fifths of MSFlow's parameters otherwise (FRONTIER §9.4).
    """

    def __init__(self, width: int, count: int, shared: bool = False) -> None:
        super().__init__()
        self.count = count
        self.offset = nn.Parameter(torch.zeros(count * width)) if shared else None
        self.read = None if shared else nn.Linear(width, count * width)
        self.close()

    def forward(self, condition: Float[Tensor, "b m"]) -> Sequence[Float[Tensor, "b 1 w"]]:
        """Return `count` vectors; `condition` is activated, or already the shared table's."""
        values = condition + self.offset if self.read is None else self.read(condition)
        return values[:, None].chunk(self.count, dim=-1)

    def close(self) -> None:
        """Start at zero."""
        if self.read is not None:
            nn.init.zeros_(self.read.weight)
            nn.init.zeros_(self.read.bias)


class Stream(nn.Module):
    """One stream's part of a block: modulated RMSNorms, gated attention and a gated SwiGLU."""

    def __init__(self, width: int, heads: int, hidden: int, shared: bool = False) -> None:
        super().__init__()
        self.attention = Projections(width, heads)
        self.norm1 = nn.RMSNorm(width, eps=1e-6)
        self.norm2 = nn.RMSNorm(width, eps=1e-6)
        self.mlp = SwiGLU(width, hidden)
        self.modulation = Modulation(width, 6, shared)


class JointBlock(nn.Module):
    """Two streams, motion and text, that attend to the positions of both (FRONTIER §2.2)."""

    def __init__(self, width: int, heads: int, hidden: int, shared: bool = False) -> None:
        super().__init__()
        self.motion = Stream(width, heads, hidden, shared)
        self.text = Stream(width, heads, hidden, shared)

    def close(self) -> None:
        """Make the block the identity, as it starts."""
        self.motion.modulation.close()
        self.text.modulation.close()

    def forward(
        self,
        motion: Float[Tensor, "b n w"],
        text: Float[Tensor, "b l w"],
        condition: Float[Tensor, "b m"],
        positions: Shaped[Tensor, " n"],
        mask: Bool[Tensor, "b 1 #q k"],
    ) -> tuple[Float[Tensor, "b n w"], Float[Tensor, "b l w"]]:
        """Transform both; `mask`, True = may be seen, is over (text, motion) keys, and queries where they differ."""
        ways = [part.modulation(condition) for part in (self.text, self.motion)]
        heads = [
            part.attention.split(modulate(part.norm1(x), way[0], way[1]), place)
            for part, x, way, place in zip(
                (self.text, self.motion), (text, motion), ways, (None, positions), strict=True
            )
        ]
        query, key, value = (torch.cat(both, dim=2) for both in zip(*heads, strict=True))
        attended = F.scaled_dot_product_attention(query, key, value, attn_mask=mask)
        words, frames = attended.split((text.shape[1], motion.shape[1]), dim=2)
        return _finish(self.motion, motion, frames, ways[1]), _finish(self.text, text, words, ways[0])


class CrossBlock(nn.Module):
    """One stream that attends to itself and, where `cross`, to a context (FRONTIER §2.7, §3)."""

    def __init__(self, width: int, heads: int, hidden: int, *, cross: bool = False, shared: bool = False) -> None:
        super().__init__()
        self.stream = Stream(width, heads, hidden, shared)
        self.cross_norm = nn.RMSNorm(width, eps=1e-6) if cross else None
        self.cross = Projections(width, heads) if cross else None
        self.close()

    def close(self) -> None:
        """Make the block the identity, as it starts."""
        self.stream.modulation.close()
        if self.cross is not None:
            nn.init.zeros_(self.cross.proj.weight)
            nn.init.zeros_(self.cross.proj.bias)

    def forward(
        self,
        x: Float[Tensor, "b n w"],
        condition: Float[Tensor, "b m"],
        positions: Shaped[Tensor, " n"],
        mask: Bool[Tensor, "b 1 #q n"] | None = None,
        context: Float[Tensor, "b l w"] | None = None,
        context_mask: Bool[Tensor, "b 1 1 l"] | None = None,
        base: float = 10000.0,
    ) -> Float[Tensor, "b n w"]:
        """Transform `x`; masks are over its own positions and over the context's, True = may be seen."""
        stream = self.stream
        way = stream.modulation(condition)
        heads = stream.attention.split(modulate(stream.norm1(x), way[0], way[1]), positions, base)
        x = x + way[2] * stream.attention.join(F.scaled_dot_product_attention(*heads, attn_mask=mask))
        if self.cross is not None and self.cross_norm is not None and context is not None:
            heads = self.cross.across(self.cross_norm(x), context)
            x = x + self.cross.join(F.scaled_dot_product_attention(*heads, attn_mask=context_mask))
        return x + way[5] * stream.mlp(modulate(stream.norm2(x), way[3], way[4]))


def _finish(part: Stream, x: Tensor, attended: Tensor, way: Sequence[Tensor]) -> Tensor:
    x = x + way[2] * part.attention.join(attended)
    return x + way[5] * part.mlp(modulate(part.norm2(x), way[3], way[4]))

"""Let streams of positions attend to themselves and to each other in modulated blocks."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float, Shaped
from torch import Tensor, nn
from torch.nn import functional as F

from kinema.nn.heads import CrossAttention, Projections
from kinema.nn.modulation import modulate
from kinema.nn.swiglu import SwiGLU


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
        values = condition[:, : len(self.offset)] + self.offset if self.offset is not None else self.read(condition)
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

    def finish(
        self, x: Float[Tensor, "b n w"], attended: Float[Tensor, "b h n d"], way: Sequence[Float[Tensor, "b 1 w"]]
    ) -> Float[Tensor, "b n w"]:
        """Add what was attended to, then the transformation of each position, both gated."""
        x = x + way[2] * self.attention.join(attended)
        return self.transform(x, way)

    def transform(self, x: Float[Tensor, "b n w"], way: Sequence[Float[Tensor, "b 1 w"]]) -> Float[Tensor, "b n w"]:
        """Add the gated transformation of each position."""
        return x + way[5] * self.mlp(modulate(self.norm2(x), way[3], way[4]))


class Context(nn.Module):
    """The text's part of the last block, of which nothing but keys and values is read."""

    def __init__(self, width: int, heads: int, shared: bool = False) -> None:
        super().__init__()
        self.heads = heads
        self.kv = nn.Linear(width, 2 * width, bias=False)
        self.key_norm = nn.RMSNorm(width // heads, eps=1e-6)
        self.norm1 = nn.RMSNorm(width, eps=1e-6)
        self.modulation = Modulation(width, 2, shared)

    def forward(
        self, x: Float[Tensor, "b n w"], condition: Float[Tensor, "b m"]
    ) -> tuple[Float[Tensor, "b h n d"], Float[Tensor, "b h n d"]]:
        """Return keys and values."""
        x = modulate(self.norm1(x), *self.modulation(condition))
        key, value = self.kv(x).unflatten(-1, (2, self.heads, -1)).permute(2, 0, 3, 1, 4)
        return self.key_norm(key), value


class JointBlock(nn.Module):
    """Two streams, motion and text, that attend to the positions of both (FRONTIER §2.2).

    `last`: the text ends here, so that what would change it isn't built.
    """

    def __init__(self, width: int, heads: int, hidden: int, *, shared: bool = False, last: bool = False) -> None:
        super().__init__()
        self.motion = Stream(width, heads, hidden, shared)
        self.text = Context(width, heads, shared) if last else Stream(width, heads, hidden, shared)
        self.last = last

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
        part, way, size = self.motion, self.motion.modulation(condition), text.shape[1]
        query, key, value = part.attention.split(modulate(part.norm1(motion), way[0], way[1]), positions)
        if isinstance(self.text, Context):
            keys, values = self.text(text, condition)
            heads = query, torch.cat((keys, key), dim=2), torch.cat((values, value), dim=2)
            attended = F.scaled_dot_product_attention(*heads, attn_mask=mask[:, :, -motion.shape[1] :])
            return part.finish(motion, attended, way), text
        other = self.text.modulation(condition)
        words = self.text.attention.split(modulate(self.text.norm1(text), other[0], other[1]))
        heads = [torch.cat(both, dim=2) for both in zip(words, (query, key, value), strict=True)]
        attended = F.scaled_dot_product_attention(*heads, attn_mask=mask)
        return part.finish(motion, attended[:, :, size:], way), self.text.finish(text, attended[:, :, :size], other)


class CrossBlock(nn.Module):
    """One stream that attends to itself and, where `cross`, to a context (FRONTIER §2.7, §3)."""

    def __init__(self, width: int, heads: int, hidden: int, *, cross: bool = False, shared: bool = False) -> None:
        super().__init__()
        self.stream = Stream(width, heads, hidden, shared)
        self.cross = CrossAttention(width, heads) if cross else None
        self.close()

    def close(self) -> None:
        """Make the block the identity, as it starts."""
        self.stream.modulation.close()
        if self.cross is not None:
            self.cross.close()

    def forward(
        self,
        x: Float[Tensor, "b n w"],
        condition: Float[Tensor, "b m"],
        positions: Shaped[Tensor, " n"],
        mask: Bool[Tensor, "b 1 #q n"] | None = None,
        context: Float[Tensor, "b l w"] | None = None,
        context_mask: Bool[Tensor, "b l"] | None = None,
        base: float = 10000.0,
    ) -> Float[Tensor, "b n w"]:
        """Transform `x`; masks are over its own positions and over the context's, True = may be seen."""
        stream = self.stream
        way = stream.modulation(condition)
        heads = stream.attention.split(modulate(stream.norm1(x), way[0], way[1]), positions, base)
        x = x + way[2] * stream.attention.join(F.scaled_dot_product_attention(*heads, attn_mask=mask))
        if self.cross is not None and context is not None:
            x = x + self.cross(x, context, context_mask)
        return stream.transform(x, way)

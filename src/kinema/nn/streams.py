"""Let streams of rows attend to themselves and to each other in modulated blocks."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional as F

from kinema.nn.attention import attend_within
from kinema.nn.heads import CrossAttention, Projections
from kinema.nn.modulation import modulate
from kinema.nn.norms import RMSNorm
from kinema.nn.rows import Rows
from kinema.nn.swiglu import SwiGLU

BASE = 10000.0
Ways = tuple[Float[Tensor, "m w"], ...]
"""Shifts, scales and gates of each row."""


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

    def forward(self, condition: Float[Tensor, "b c"], rows: Rows) -> Ways:
        """Return `count` vectors for each row; `condition` is activated, or already the shared table's."""
        if self.read is not None:
            values = self.read(condition)
        else:
            assert self.offset is not None  # one of the two is there
            values = condition[:, : len(self.offset)] + self.offset
        return rows.spread(values).chunk(self.count, dim=-1)

    def close(self) -> None:
        """Start at zero."""
        if self.read is not None:
            nn.init.zeros_(self.read.weight)
            nn.init.zeros_(self.read.bias)


def initialize(module: nn.Module) -> None:
    """Draw Linear weights Xavier-uniform, biases 0; what modulates and what reads a context starts closed."""
    for part in module.modules():
        if isinstance(part, nn.Linear):
            nn.init.xavier_uniform_(part.weight)
            if part.bias is not None:
                nn.init.zeros_(part.bias)
    for part in module.modules():
        if isinstance(part, Modulation | CrossAttention):
            part.close()


class Stream(nn.Module):
    """One stream's part of a block: modulated RMSNorms, gated attention and a gated SwiGLU."""

    def __init__(self, width: int, heads: int, hidden: int, shared: bool = False) -> None:
        super().__init__()
        self.attention = Projections(width, heads)
        self.norm1 = RMSNorm(width)
        self.norm2 = RMSNorm(width)
        self.mlp = SwiGLU(width, hidden)
        self.modulation = Modulation(width, 6, shared)

    def attended(self, x: Float[Tensor, "m w"], attended: Float[Tensor, "m h d"], ways: Ways) -> Float[Tensor, "m w"]:
        """Add what was attended to, gated."""
        return x + ways[2] * self.attention.join(attended)

    def transformed(self, x: Float[Tensor, "m w"], ways: Ways) -> Float[Tensor, "m w"]:
        """Add the gated transformation of each row."""
        return x + ways[5] * self.mlp(modulate(self.norm2(x), ways[3], ways[4]))


class Context(nn.Module):
    """The text's part of the last block, of which nothing but keys and values is read."""

    def __init__(self, width: int, heads: int, shared: bool = False) -> None:
        super().__init__()
        self.heads = heads
        self.kv = nn.Linear(width, 2 * width, bias=False)
        self.key_norm = RMSNorm(width // heads)
        self.norm1 = RMSNorm(width)
        self.modulation = Modulation(width, 2, shared)

    def forward(
        self, x: Float[Tensor, "m w"], condition: Float[Tensor, "b c"], rows: Rows
    ) -> tuple[Float[Tensor, "m h d"], Float[Tensor, "m h d"]]:
        """Return keys and values."""
        x = modulate(self.norm1(x), *self.modulation(condition, rows))
        key, value = self.kv(x).unflatten(-1, (2, self.heads, -1)).unbind(1)
        return self.key_norm(key), value


class JointBlock(nn.Module):
    """Two streams, motion and text, that attend to the rows of both (FRONTIER §2.2).

    `last`: the text ends here, so that what would change it isn't built.
    """

    def __init__(self, width: int, heads: int, hidden: int, *, shared: bool = False, last: bool = False) -> None:
        super().__init__()
        self.motion = Stream(width, heads, hidden, shared)
        self.text = Context(width, heads, shared) if last else Stream(width, heads, hidden, shared)

    def forward(
        self,
        motion: Float[Tensor, "m w"],
        frames: Rows,
        text: Float[Tensor, "l w"],
        words: Rows,
        condition: Float[Tensor, "b c"],
        mask: Bool[Tensor, "b 1 #q k"],
    ) -> tuple[Float[Tensor, "m w"], Float[Tensor, "l w"]]:
        """Transform both; `mask`, True = may be seen, is over (text, motion) keys, and queries where they differ."""
        part, ways, size = self.motion, self.motion.modulation(condition, frames), words.real.shape[1]
        own = part.attention.split(modulate(part.norm1(motion), ways[0], ways[1]), frames, base=BASE)
        if isinstance(self.text, Context):
            query = frames.pad(own[0]).transpose(1, 2)
            read = zip(self.text(text, condition, words), own[1:], strict=True)
            key, value = (_beside(words, theirs, frames, ours) for theirs, ours in read)
            mask = mask[:, :, -frames.real.shape[1] :]
            attended = F.scaled_dot_product_attention(query, key, value, attn_mask=mask).transpose(1, 2)
            return part.transformed(part.attended(motion, frames.pack(attended), ways), ways), text
        other, others = self.text, self.text.modulation(condition, words)
        read = zip(other.attention.split(modulate(other.norm1(text), others[0], others[1]), words), own, strict=True)
        query, key, value = (_beside(words, theirs, frames, ours) for theirs, ours in read)
        attended = F.scaled_dot_product_attention(query, key, value, attn_mask=mask).transpose(1, 2)
        motion = part.attended(motion, frames.pack(attended[:, size:]), ways)
        text = other.attended(text, words.pack(attended[:, :size]), others)
        return part.transformed(motion, ways), other.transformed(text, others)


class CrossBlock(nn.Module):
    """One stream that attends to itself and, where `cross`, to a context (FRONTIER §2.7, §3)."""

    def __init__(self, width: int, heads: int, hidden: int, *, cross: bool = False, shared: bool = False) -> None:
        super().__init__()
        self.stream = Stream(width, heads, hidden, shared)
        self.cross = CrossAttention(width, heads) if cross else None

    def forward(
        self,
        x: Float[Tensor, "m w"],
        rows: Rows,
        condition: Float[Tensor, "b c"],
        mask: Bool[Tensor, "b 1 #q k"] | None = None,
        held: Float[Tensor, "b l e"] | None = None,
        seen: Bool[Tensor, "b l"] | None = None,
        *,
        base: float = BASE,
    ) -> Float[Tensor, "m w"]:
        """Transform `x`; it attends to its own sequence, or what `mask` over padded positions shows of it.

        `held` is what `cross` read.
        """
        part, ways = self.stream, self.stream.modulation(condition, rows)
        heads = part.attention.split(modulate(part.norm1(x), ways[0], ways[1]), rows, base=base)
        x = part.attended(x, attend_within(*heads, rows, mask), ways)
        if self.cross is not None and held is not None and seen is not None:
            x = x + self.cross(x, rows, held, seen)
        return part.transformed(x, ways)


def _beside(
    words: Rows, text: Float[Tensor, "l h d"], frames: Rows, motion: Float[Tensor, "m h d"]
) -> Float[Tensor, "b h n d"]:
    """Lay heads of the motion behind those of the text, padded."""
    return torch.cat((words.pad(text), frames.pad(motion)), dim=1).transpose(1, 2)

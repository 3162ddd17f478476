"""Build the transformer blocks: pre-norm (T2M-GPT, AttT2M, MMM, BAD), post-norm (MoMask, BAMM, MDM, MotionDiffuse)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from jaxtyping import Bool, Float
from torch import Tensor, nn

from kinema.nn.attention import Attention, KeyValueCache
from kinema.nn.rows import Rows

NORMS = ("pre", "post")


class TransformerBlock(nn.Module):
    """Attend (to oneself, or with `cross` to a context), then transform each position.

    norm="pre" (COMMON §5): x += attention(norm1 x); x += mlp(norm2 x); a context is normed by norm3; dropout acts on
    the attention and on what a branch adds. norm="post" (torch's encoder layer, MoMask §2): x = norm1(x +
    attention(x)); x = norm2(x + mlp(x)); dropout acts inside the mlp too.
    """

    def __init__(
        self, width: int, heads: int, feedforward: int, dropout: float = 0.0, *, norm: str = "pre", cross: bool = False
    ) -> None:
        super().__init__()
        if norm not in NORMS:
            raise ValueError(f"norm {norm!r} is unknown; choose one of {', '.join(NORMS)}")
        self.pre = norm == "pre"
        self.attention = Attention(width, heads, dropout)
        self.norm1 = nn.LayerNorm(width)
        self.norm2 = nn.LayerNorm(width)
        self.norm3 = nn.LayerNorm(width) if cross else None
        self.mlp = nn.Sequential(
            nn.Linear(width, feedforward),
            nn.GELU(),
            nn.Dropout(0.0 if self.pre else dropout),
            nn.Linear(feedforward, width),
            nn.Dropout(dropout),
        )

    def forward(
        self,
        x: Float[Tensor, "*q w"],
        mask: Bool[Tensor, "..."] | None = None,
        context: Float[Tensor, "b k w"] | None = None,
        cache: KeyValueCache | None = None,
        rows: Rows | None = None,
    ) -> Float[Tensor, "*q w"]:
        """Transform `x`, padded or the `rows` of a batch; masks as in `Attention`."""
        if self.norm3 is not None:
            context = self.norm3(context)
        if self.pre:
            x = x + self.attention(self.norm1(x), mask, context, cache, rows)
            return x + self.mlp(self.norm2(x))
        x = self.norm1(x + self.attention(x, mask, context, cache, rows))
        return self.norm2(x + self.mlp(x))


class DecoderBlock(nn.Module):
    """Attend to oneself, then to a context, then transform each position: torch's post-norm decoder layer (MDM §2).

    Dropout acts as in a post-norm `TransformerBlock`.
    """

    def __init__(self, width: int, heads: int, feedforward: int, dropout: float = 0.0) -> None:
        super().__init__()
        self.block = TransformerBlock(width, heads, feedforward, dropout, norm="post")
        self.cross = Attention(width, heads, dropout)
        self.cross_norm = nn.LayerNorm(width)

    def forward(
        self,
        x: Float[Tensor, "*q w"],
        context: Float[Tensor, "b k w"],
        seen: Bool[Tensor, "b k"] | None = None,
        rows: Rows | None = None,
    ) -> Float[Tensor, "*q w"]:
        """Transform `x`, padded or the `rows` of a batch; of the context it reads what is `seen` (None: all)."""
        block = self.block
        x = block.norm1(x + block.attention(x, rows=rows))
        x = self.cross_norm(x + self.cross(x, seen, context, rows=rows))
        return block.norm2(x + block.mlp(x))


def run(
    blocks: Iterable[nn.Module],
    x: Float[Tensor, "*q w"],
    mask: Bool[Tensor, "..."] | None = None,
    caches: Sequence[KeyValueCache] | None = None,
    rows: Rows | None = None,
) -> Float[Tensor, "*q w"]:
    """Send `x`, padded or the `rows` of a batch, through self-attention blocks, each with its own cache if any."""
    for i, block in enumerate(blocks):
        x = block(x, mask, cache=caches[i] if caches else None, rows=rows)
    return x


def initialize_as_torch(blocks: nn.ModuleList) -> None:
    """Start as torch's stacks of layers do: attention Xavier, its biases 0, all blocks copies of the first (MDM §2).

    A stack may be of no block.
    """
    for part in (part for block in blocks[:1] for part in block.modules()):
        if isinstance(part, Attention):
            for layer in (part.query, part.key, part.value):
                nn.init.xavier_uniform_(layer.weight, gain=2**-0.5)  # as the rows of one matrix three times as high
                nn.init.zeros_(layer.bias)
            nn.init.zeros_(part.proj.bias)
    for block in blocks[1:]:
        block.load_state_dict(blocks[0].state_dict())


def initialize(module: nn.Module, std: float = 0.02) -> None:
    """Draw Linear and Embedding weights from N(0, std), biases 0; norms start at one and zero (COMMON §5)."""
    for part in module.modules():
        if isinstance(part, nn.Linear | nn.Embedding):
            nn.init.normal_(part.weight, std=std)
        if isinstance(part, nn.Linear) and part.bias is not None:
            nn.init.zeros_(part.bias)

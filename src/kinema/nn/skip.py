"""Run transformer blocks as a U with skip connections: MLD's encoder and decoder (MLD §1)."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from kinema.nn.attention import Attention
from kinema.nn.rows import Rows
from kinema.nn.transformer import DecoderBlock, TransformerBlock, initialize_as_torch


class SkipTransformer(nn.Module):
    """Run post-norm blocks of which each behind the middle reads what its mirror before it made, merged by a Linear.

    `layers` is odd. With `cross` the blocks attend to a context too, as torch's decoder layers do.
    """

    def __init__(
        self, width: int, heads: int, feedforward: int, layers: int, dropout: float = 0.0, *, cross: bool = False
    ) -> None:
        super().__init__()
        if layers < 1 or layers % 2 == 0:
            raise ValueError(f"layers={layers}; give an odd number, so that there is a middle one")

        def blocks(count: int) -> nn.ModuleList:
            if cross:
                return nn.ModuleList(DecoderBlock(width, heads, feedforward, dropout) for _ in range(count))
            return nn.ModuleList(
                TransformerBlock(width, heads, feedforward, dropout, norm="post") for _ in range(count)
            )

        half = layers // 2
        self.inputs, (self.middle,), self.outputs = blocks(half), blocks(1), blocks(half)
        self.merges = nn.ModuleList(nn.Linear(2 * width, width) for _ in range(half))
        self.norm = nn.LayerNorm(width)
        self._initialize()

    def forward(
        self,
        x: Float[Tensor, "m w"],
        rows: Rows,
        context: Float[Tensor, "b k w"] | None = None,
    ) -> Float[Tensor, "m w"]:
        """Transform the `rows` of a batch, which attend to those of their sequence, and to a context."""
        made = []
        for block in self.inputs:
            x = _run(block, x, rows, context)
            made.append(x)
        x = _run(self.middle, x, rows, context)
        for merge, block in zip(self.merges, self.outputs, strict=True):
            x = _run(block, merge(torch.cat((x, made.pop()), dim=-1)), rows, context)
        return self.norm(x)

    def _initialize(self) -> None:
        """Start as published: all blocks have the biases of one, and each matrix a Xavier draw of its own."""
        initialize_as_torch(nn.ModuleList((*self.inputs, self.middle, *self.outputs)))
        for merge in self.merges[1:]:
            merge.load_state_dict(self.merges[0].state_dict())
        for layer in self.modules():
            if isinstance(layer, nn.Linear):
                nn.init.xavier_uniform_(layer.weight)
        for part in self.modules():
            if isinstance(part, Attention):
                for layer in (part.query, part.key, part.value):
                    nn.init.xavier_uniform_(layer.weight, gain=2**-0.5)  # as the rows of one matrix


def _run(
    block: nn.Module, x: Float[Tensor, "m w"], rows: Rows, context: Float[Tensor, "b k w"] | None
) -> Float[Tensor, "m w"]:
    return block(x, rows=rows) if context is None else block(x, context, rows=rows)

"""Encode tokens behind a condition: the post-norm transformer that MoMask, its residual transformer and BAMM share."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from kinema.nn.attention import KeyValueCache
from kinema.nn.embeddings import sinusoidal_positions
from kinema.nn.rows import Rows
from kinema.nn.transformer import TransformerBlock, run

EMBEDDING_STD = 0.02
"""Of the token vectors that the owners of an encoder start with."""
LAYER_NORM_EPSILON = 1e-12
"""Of the output's norm alone (MoMask §2)."""


class TokenEncoder(nn.Module):
    """Post-norm transformer over a prefix of conditions and projected tokens, with a two-layer output (MoMask §2).

    Tokens come as vectors of `code_dim`, since the methods embed them differently. `place_prefix` gives the prefix
    positions and dropout too (BAMM); without it the first token is position 0 (MoMask).
    """

    def __init__(
        self,
        *,
        code_dim: int,
        text_dim: int,
        outputs: int,
        width: int = 384,
        feedforward: int = 1024,
        layers: int = 8,
        heads: int = 6,
        dropout: float = 0.2,
        place_prefix: bool = False,
    ) -> None:
        super().__init__()
        self.place_prefix = place_prefix
        self.input_projection = nn.Linear(code_dim, width)
        self.text_projection = nn.Linear(text_dim, width)
        self.dropout = nn.Dropout(dropout)
        self.blocks = nn.ModuleList(
            TransformerBlock(width, heads, feedforward, dropout, norm="post") for _ in range(layers)
        )
        self.output = nn.Sequential(
            nn.Linear(width, width),
            nn.GELU(),
            nn.LayerNorm(width, eps=LAYER_NORM_EPSILON),
            nn.Linear(width, outputs),
        )
        self.reset_parameters()

    def reset_parameters(self) -> None:
        """Initialise so that projected tokens start as large as positions (ours; the specs are silent)."""
        for part in self.modules():
            if isinstance(part, nn.Linear):
                nn.init.xavier_uniform_(part.weight)
                nn.init.zeros_(part.bias)
        nn.init.normal_(self.input_projection.weight, std=1 / (EMBEDDING_STD * self.input_projection.in_features**0.5))

    def embed(
        self, tokens: Float[Tensor, "b n c"], prefix: Float[Tensor, "b p w"] | None = None, start: int = 0
    ) -> Float[Tensor, "b s w"]:
        """Make the input sequence: the prefix (already `width` wide), then the projected tokens, with positions.

        `start` is the position of the first row that gets one (for what follows a cache).
        """
        x = self.input_projection(tokens)
        if prefix is None:
            return self._place(x, start)
        if self.place_prefix:
            return self._place(torch.cat((prefix, x), dim=1), start)
        return torch.cat((prefix, self._place(x, start)), dim=1)

    def forward(
        self,
        x: Float[Tensor, "b s w"],
        mask: Bool[Tensor, "..."] | None = None,
        caches: Sequence[KeyValueCache] | None = None,
        real: Bool[Tensor, "b n"] | None = None,
    ) -> Float[Tensor, "b s o"]:
        """Return the output at every position of what `embed` made; masks as in `Attention` (None: all see all).

        `real` tells the tokens behind the prefix from padding, which isn't computed: its output is zero.
        """
        if real is None:
            return self.output(run(self.blocks, x, mask, caches))
        rows = Rows.behind(x.shape[1] - real.shape[1], real)
        return rows.pad(self.output(run(self.blocks, rows.pack(x), mask, caches, rows)))

    def _place(self, x: Float[Tensor, "b s w"], start: int) -> Float[Tensor, "b s w"]:
        positions = sinusoidal_positions(start + x.shape[1], x.shape[2], x.device)[start:]
        return self.dropout(x + positions.to(x.dtype))


def guided_logits(
    predict: Callable[..., Float[Tensor, "b n k"]],
    tokens: Tensor,
    text: Float[Tensor, "b t"],
    *others: Tensor,
    scale: float,
) -> Float[Tensor, "b n k"]:
    """Call `predict(tokens, text, *others)` with and without the text in one batch: empty + scale * (text - empty).

    The empty condition is a zero text vector (MoMask §2); scale 1 costs one pass.
    """
    if scale == 1:
        return predict(tokens, text, *others)
    doubled = [torch.cat((x, x)) for x in (tokens, *others)]
    conditional, empty = predict(doubled[0], torch.cat((text, torch.zeros_like(text))), *doubled[1:]).chunk(2)
    return empty + scale * (conditional - empty)

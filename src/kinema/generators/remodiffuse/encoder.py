"""Encode retrieved motions and their texts, trained with the denoiser that reads them (ReMoDiffuse §3)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from kinema.generators.remodiffuse.database import Neighbours
from kinema.nn.rows import Rows
from kinema.nn.stylization import linear_attention
from kinema.nn.transformer import TransformerBlock, initialize_as_torch, run
from kinema.types import frame_mask


@dataclass(frozen=True)
class Retrieved:
    """Hold what was read of each sample's neighbours, all positions of all of them, and which may be seen (True)."""

    motions: Float[Tensor, "b r w"]
    texts: Float[Tensor, "b r w"]
    seen: Bool[Tensor, "b r"]

    def rows(self, rows: Tensor, keep: Bool[Tensor, " s"]) -> Retrieved:
        """Take some samples' neighbours, and of these hide all but the ones to `keep`."""
        return Retrieved(self.motions[rows], self.texts[rows], self.seen[rows] & keep[:, None])


class RetrievedBlock(nn.Module):
    """Attend to a motion's own frames in linear time, then transform each frame; it starts without the latter."""

    def __init__(self, width: int, heads: int, feedforward: int) -> None:
        super().__init__()
        self.heads = heads
        self.norm = nn.LayerNorm(width)
        self.query = nn.Linear(width, width)
        self.key = nn.Linear(width, width)
        self.value = nn.Linear(width, width)
        last = nn.Linear(feedforward, width)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        self.mlp = nn.Sequential(nn.Linear(width, feedforward), nn.GELU(), last)

    def forward(self, x: Float[Tensor, "m w"], rows: Rows) -> Float[Tensor, "m w"]:
        own = self.norm(x)
        query, key, value = (
            rows.pad(layer(own)).unflatten(-1, (self.heads, -1)).transpose(1, 2)
            for layer in (self.query, self.key, self.value)
        )
        attended = linear_attention(query, key, value, rows.real[:, None])
        x = x + rows.pack(attended.transpose(1, 2)).flatten(1)
        return x + self.mlp(x)


class RetrievalEncoder(nn.Module):
    """Encode neighbours: every `stride`-th frame of each motion, and the last position of its text (not its end).

    Token features of another width than `width`, which published ones have, are projected first.
    """

    def __init__(
        self,
        frame_dim: int,
        *,
        token_dim: int,
        max_frames: int,
        width: int,
        feedforward: int,
        layers: int,
        text_layers: int,
        heads: int,
        stride: int,
    ) -> None:
        super().__init__()
        self.stride = stride
        self.input_projection = nn.Linear(frame_dim, width)
        self.positions = nn.Parameter(torch.randn(max_frames, width))
        self.blocks = nn.ModuleList(RetrievedBlock(width, heads, feedforward) for _ in range(layers))
        self.text_projection = nn.Identity() if token_dim == width else nn.Linear(token_dim, width)
        self.text_blocks = nn.ModuleList(
            TransformerBlock(width, heads, feedforward, norm="post") for _ in range(text_layers)
        )
        initialize_as_torch(self.text_blocks)

    def forward(self, neighbours: Neighbours) -> Retrieved:
        """Encode each neighbour by itself; a text's feature stands beside every position of its motion."""
        samples, count, frames = neighbours.motions.shape[:3]
        rows = Rows(frame_mask(neighbours.lengths.flatten(), frames))
        x = self.input_projection(rows.pack(neighbours.motions.flatten(0, 1)))
        x = x + self.positions.index_select(0, rows.place)
        for block in self.blocks:
            x = block(x, rows)
        motions, real = rows.pad(x)[:, :: self.stride], rows.real[:, :: self.stride]
        texts = self.read(neighbours)[:, None].expand_as(motions)
        return Retrieved(*(part.unflatten(0, (samples, count)).flatten(1, 2) for part in (motions, texts, real)))

    def read(self, neighbours: Neighbours) -> Float[Tensor, "n w"]:
        """Return what was read at the last position of each neighbour's text."""
        tokens, counts = neighbours.tokens.flatten(0, 1), neighbours.token_lengths.flatten()
        rows = Rows(frame_mask(counts, tokens.shape[1]))
        read = run(self.text_blocks, self.text_projection(rows.pack(tokens)), rows=rows)
        return rows.pad(read)[torch.arange(len(counts), device=counts.device), counts - 1]

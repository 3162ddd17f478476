"""Denoise frames under a text and retrieved motions by semantics-modulated attention (ReMoDiffuse §4)."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from kinema.generators.frames.denoiser import Denoiser, Read
from kinema.generators.remodiffuse.encoder import RetrievalEncoder, Retrieved
from kinema.nn.embeddings import timestep_embedding
from kinema.nn.rows import Rows
from kinema.nn.stylization import Stylization, StylizedFeedForward, linear_attention
from kinema.nn.transformer import TransformerBlock, initialize_as_torch, run
from kinema.types import TextFeatures


class SemanticsModulatedAttention(nn.Module):
    """Attend in linear time to the text, to what was retrieved and to the frames at once, and add it stylised.

    What was retrieved has no influence at the start.
    """

    def __init__(self, width: int, heads: int, embedding: int, words: int, dropout: float) -> None:
        super().__init__()
        if width % heads:
            raise ValueError(f"width {width} is not a multiple of heads {heads}; choose heads that divide the width")
        self.heads = heads
        self.norm, self.text_norm = nn.LayerNorm(width), nn.LayerNorm(words)
        self.pair_norm, self.retrieved_norm = nn.LayerNorm(2 * width), nn.LayerNorm(width)
        self.query = nn.Linear(width, width)
        self.text_key, self.text_value = nn.Linear(words, width), nn.Linear(words, width)
        self.retrieved_key, self.retrieved_value = nn.Linear(2 * width, width), nn.Linear(width, width)
        self.key, self.value = nn.Linear(width, width), nn.Linear(width, width)
        self.style = Stylization(width, embedding, dropout)
        nn.init.zeros_(self.retrieved_value.weight)
        nn.init.zeros_(self.retrieved_value.bias)

    def forward(
        self,
        x: Float[Tensor, "m w"],
        rows: Rows,
        embedding: Float[Tensor, "b e"],
        words: Float[Tensor, "b l c"],
        seen: Bool[Tensor, "b l"],
        retrieved: Retrieved | None,
    ) -> Float[Tensor, "m w"]:
        """Attend to the words that may be seen and the frames, and to what was retrieved if it is given."""
        own, words = self.norm(x), self.text_norm(words)
        keys, values, masks = [self.text_key(words)], [self.text_value(words)], [seen]
        if retrieved is not None:
            pair = self.pair_norm(torch.cat((retrieved.motions, retrieved.texts), dim=-1))
            keys.append(self.retrieved_key(pair))
            values.append(self.retrieved_value(self.retrieved_norm(retrieved.motions)))
            masks.append(retrieved.seen)
        keys, values, masks = (
            [*keys, rows.pad(self.key(own))],
            [*values, rows.pad(self.value(own))],
            [*masks, rows.real],
        )
        query, key, value = (
            part.unflatten(-1, (self.heads, -1)).transpose(1, 2)
            for part in (rows.pad(self.query(own)), torch.cat(keys, dim=1), torch.cat(values, dim=1))
        )
        attended = linear_attention(query, key, value, torch.cat(masks, dim=1)[:, None])
        return x + self.style(rows.pack(attended.transpose(1, 2)).flatten(1), rows, embedding)


class RetrievalBlock(nn.Module):
    """Attend to all there is, then transform each frame."""

    def __init__(self, width: int, heads: int, feedforward: int, embedding: int, words: int, dropout: float) -> None:
        super().__init__()
        self.attention = SemanticsModulatedAttention(width, heads, embedding, words, dropout)
        self.mlp = StylizedFeedForward(width, feedforward, embedding, dropout)

    def forward(
        self,
        x: Float[Tensor, "m w"],
        rows: Rows,
        embedding: Float[Tensor, "b e"],
        words: Float[Tensor, "b l c"],
        seen: Bool[Tensor, "b l"],
        retrieved: Retrieved | None,
    ) -> Float[Tensor, "m w"]:
        return self.mlp(self.attention(x, rows, embedding, words, seen, retrieved), rows, embedding)


class ReMoDiffuseDenoiser(Denoiser):
    """Blocks over at most `max_frames` frames, under a transformer over the text's tokens and a `RetrievalEncoder`.

    `embedding` is the width of the time's embedding (None: four times `width`); `retrieval_*` and `stride` are the
    encoder's, `retrieved_dim` is the width of the token features that it reads (None: `token_dim`).
    """

    def __init__(
        self,
        frame_dim: int,
        *,
        token_dim: int,
        max_frames: int = 196,
        width: int = 512,
        feedforward: int = 1024,
        layers: int = 4,
        heads: int = 8,
        embedding: int | None = None,
        text_width: int = 256,
        text_feedforward: int = 2048,
        text_layers: int = 2,
        text_heads: int = 4,
        retrieval_layers: int = 2,
        retrieval_text_layers: int = 2,
        retrieved_dim: int | None = None,
        stride: int = 4,
        dropout: float = 0.0,
    ) -> None:
        super().__init__()
        self.width, embedding = width, embedding or 4 * width
        self.text_projection = nn.Linear(token_dim, text_width)
        self.text_blocks = nn.ModuleList(
            TransformerBlock(text_width, text_heads, text_feedforward, norm="post") for _ in range(text_layers)
        )
        self.text_norm = nn.LayerNorm(text_width)
        self.retrieval = RetrievalEncoder(
            frame_dim,
            token_dim=retrieved_dim or token_dim,
            max_frames=max_frames,
            width=width,
            feedforward=feedforward,
            layers=retrieval_layers,
            text_layers=retrieval_text_layers,
            heads=heads,
            stride=stride,
        )
        self.time = nn.Sequential(nn.Linear(width, embedding), nn.SiLU(), nn.Linear(embedding, embedding))
        self.input_projection = nn.Linear(frame_dim, width)
        self.positions = nn.Parameter(torch.randn(max_frames, width))
        self.blocks = nn.ModuleList(
            RetrievalBlock(width, heads, feedforward, embedding, text_width, dropout) for _ in range(layers)
        )
        self.output = nn.Linear(width, frame_dim)
        nn.init.zeros_(self.output.weight)
        nn.init.zeros_(self.output.bias)
        initialize_as_torch(self.text_blocks)

    def read(self, text: TextFeatures) -> Read:
        """Read the text's tokens; the empty condition is none of them seen."""
        if text.tokens is None:
            raise ValueError(
                "this denoiser attends to tokens, but the text features hold the pooled vector alone; encode the text "
                "with token features (reads_tokens: true)"
            )
        seen = text.token_mask
        rows = Rows.of(text.tokens, seen)
        read = run(self.text_blocks, self.text_projection(rows.pack(text.tokens)), rows=rows)
        return rows.pad(self.text_norm(read)), seen

    def forward(
        self,
        x: Float[Tensor, "b t d"],
        time: Tensor,
        condition: Float[Tensor, "b l w"],
        seen: Bool[Tensor, "b m"] | None = None,
        real: Bool[Tensor, "b t"] | None = None,
        retrieved: Retrieved | None = None,
    ) -> Float[Tensor, "b t d"]:
        """Predict at one time for all rows or one per row, from the words that were read and what was retrieved."""
        seen = condition.new_ones(condition.shape[:2], dtype=torch.bool) if seen is None else seen
        rows = Rows.of(x, real)
        embedding = self.embed_time(time).expand(len(x), -1)
        x = self.input_projection(rows.pack(x)) + self.positions.index_select(0, rows.place)
        for block in self.blocks:
            x = block(x, rows, embedding, condition, seen, retrieved)
        return rows.pad(self.output(x))

    def embed_time(self, time: Tensor) -> Float[Tensor, "n e"]:
        """Embed a single time (one row, broadcast later) or one time per row, as they are."""
        embedded = timestep_embedding(time.reshape(-1), self.width)
        return self.time(embedded.to(self.input_projection.weight.dtype))

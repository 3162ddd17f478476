"""Denoise frames with MotionDiffuse's transformer of stylised branches (MotionDiffuse)."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from kinema.generators.frames.denoiser import Denoiser, Read
from kinema.nn.embeddings import timestep_embedding
from kinema.nn.rows import Rows
from kinema.nn.stylization import StylizedAttention, StylizedFeedForward
from kinema.nn.transformer import TransformerBlock, initialize_as_torch, run
from kinema.types import TextFeatures


class StylizedBlock(nn.Module):
    """Attend to the frames, then to the words, then transform each frame."""

    def __init__(
        self, width: int, heads: int, feedforward: int, embedding: int, words: int, dropout: float, attention: str
    ) -> None:
        super().__init__()
        self.attention = StylizedAttention(width, heads, embedding, attention=attention, dropout=dropout)
        self.cross = StylizedAttention(width, heads, embedding, context_dim=words, attention=attention, dropout=dropout)
        self.mlp = StylizedFeedForward(width, feedforward, embedding, dropout)

    def forward(
        self,
        x: Float[Tensor, "m w"],
        rows: Rows,
        embedding: Float[Tensor, "b e"],
        words: Float[Tensor, "b l c"],
        seen: Bool[Tensor, "b l"] | None,
    ) -> Float[Tensor, "m w"]:
        x = self.attention(x, rows, embedding)
        x = self.cross(x, rows, embedding, words, seen)
        return self.mlp(x, rows, embedding)


class MotionDiffuseDenoiser(Denoiser):
    """Stylised blocks over at most `max_frames` frames, under a transformer over the text's tokens.

    `attention` is "linear" or "softmax" (the published `no_eff`, which lets frames see padding; this one doesn't). The
    text's own transformer has no dropout, as published.
    """

    def __init__(
        self,
        frame_dim: int,
        *,
        token_dim: int,
        max_frames: int = 196,
        width: int = 512,
        feedforward: int = 1024,
        layers: int = 8,
        heads: int = 8,
        text_width: int = 256,
        text_feedforward: int = 2048,
        text_layers: int = 4,
        text_heads: int = 4,
        dropout: float = 0.0,
        attention: str = "linear",
    ) -> None:
        super().__init__()
        self.width, embedding = width, 4 * width
        self.text_projection = nn.Linear(token_dim, text_width)
        self.text_blocks = nn.ModuleList(
            TransformerBlock(text_width, text_heads, text_feedforward, norm="post") for _ in range(text_layers)
        )
        self.text_norm = nn.LayerNorm(text_width)
        self.sentence_projection = nn.Linear(text_width, embedding)
        self.time = nn.Sequential(nn.Linear(width, embedding), nn.SiLU(), nn.Linear(embedding, embedding))
        self.input_projection = nn.Linear(frame_dim, width)
        self.positions = nn.Parameter(torch.randn(max_frames, width))
        self.blocks = nn.ModuleList(
            StylizedBlock(width, heads, feedforward, embedding, text_width, dropout, attention) for _ in range(layers)
        )
        self.output = nn.Linear(width, frame_dim)
        nn.init.zeros_(self.output.weight)
        nn.init.zeros_(self.output.bias)
        initialize_as_torch(self.text_blocks)

    def read(self, text: TextFeatures) -> Read:
        """Read the text's own tokens, the last of which stands for the sentence."""
        if text.tokens is None:
            raise ValueError(
                "this denoiser attends to tokens, but the text features hold the pooled vector alone; encode the text "
                "with token features (reads_tokens: true)"
            )
        seen = text.token_mask
        ends = text.tokens.new_full((len(text.tokens),), text.tokens.shape[1]) if seen is None else seen.sum(dim=1)
        return self.read_tokens(text.tokens, ends.long() - 1, seen), seen

    def read_tokens(
        self, tokens: Float[Tensor, "b l c"], ends: Int[Tensor, " b"], seen: Bool[Tensor, "b l"] | None = None
    ) -> Float[Tensor, "b m w"]:
        """Return m = l + 1 rows: what was read at `ends`, which stands for the sentence, and at every token."""
        rows = Rows.of(tokens, seen)
        read = run(self.text_blocks, self.text_projection(rows.pack(tokens)), rows=rows)
        words = rows.pad(self.text_norm(read))
        sentence = words[torch.arange(len(words), device=words.device), ends]
        return torch.cat((sentence[:, None], words), dim=1)

    def forward(
        self,
        x: Float[Tensor, "b t d"],
        time: Tensor,
        condition: Float[Tensor, "b l w"],
        seen: Bool[Tensor, "b m"] | None = None,
        real: Bool[Tensor, "b t"] | None = None,
    ) -> Float[Tensor, "b t d"]:
        """Predict at one time for all rows or one per row, from what `read_tokens` made; `seen` is over tokens."""
        rows = Rows.of(x, real)
        embedding = self.embed_time(time) + self.sentence_projection(condition[:, 0])
        words = condition[:, 1:]
        x = self.input_projection(rows.pack(x)) + self.positions.index_select(0, rows.place)
        for block in self.blocks:
            x = block(x, rows, embedding, words, seen)
        return rows.pad(self.output(x))

    def embed_time(self, time: Tensor) -> Float[Tensor, "n e"]:
        """Embed a single time (one row, broadcast later) or one time per row, as they are."""
        embedded = timestep_embedding(time.reshape(-1), self.width)
        return self.time(embedded.to(self.input_projection.weight.dtype))

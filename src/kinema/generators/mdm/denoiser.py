"""Denoise frames with MDM's transformer (MDM §2)."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional as F

from kinema.generators.frames.denoiser import Denoiser, Read
from kinema.nn.embeddings import interleaved_embedding, sinusoidal_positions
from kinema.nn.rows import Rows
from kinema.nn.transformer import DecoderBlock, TransformerBlock, initialize_as_torch, run
from kinema.types import TextFeatures

ARCHITECTURES = ("encoder", "decoder")


class MdmDenoiser(Denoiser):
    """Post-norm transformer over frames and a condition, which is the text with the time added.

    "encoder": the condition is the first of the sequence; "decoder": the frames attend to it. It is the pooled vector
    (`text_dim`) or one for each token (`token_dim`), as which of the two is given.
    """

    def __init__(
        self,
        frame_dim: int,
        *,
        text_dim: int | None = None,
        token_dim: int | None = None,
        width: int = 512,
        feedforward: int = 1024,
        layers: int = 8,
        heads: int = 4,
        dropout: float = 0.1,
        architecture: str = "encoder",
    ) -> None:
        super().__init__()
        if architecture not in ARCHITECTURES:
            raise ValueError(f"architecture {architecture!r} is unknown; choose one of {', '.join(ARCHITECTURES)}")
        given = token_dim if text_dim is None else text_dim
        if given is None or None not in (text_dim, token_dim):
            raise ValueError(
                f"text_dim={text_dim} and token_dim={token_dim}; give one of the two: the width of the pooled text "
                "vector, or that of the tokens' features"
            )
        self.reads_tokens = token_dim is not None
        self.text_projection = nn.Linear(given, width)
        self.width = width
        self.time = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
        self.input_projection = nn.Linear(frame_dim, width)
        self.dropout = nn.Dropout(dropout)
        self.encodes = architecture == "encoder"
        self.blocks = nn.ModuleList(
            TransformerBlock(width, heads, feedforward, dropout, norm="post")
            if self.encodes
            else DecoderBlock(width, heads, feedforward, dropout)
            for _ in range(layers)
        )
        self.output = nn.Linear(width, frame_dim)
        initialize_as_torch(self.blocks)

    def read(self, text: TextFeatures) -> Read:
        """Project the pooled vector, or each token."""
        if not self.reads_tokens:
            return self.text_projection(text.pooled)[:, None], None
        if text.tokens is None:
            raise ValueError(
                "this denoiser attends to tokens, but the text features hold the pooled vector alone; encode the text "
                "with token features (reads_tokens: true), or build it with text_dim instead of token_dim"
            )
        return self.text_projection(text.tokens), text.token_mask

    def forward(
        self,
        x: Float[Tensor, "b t d"],
        time: Tensor,
        condition: Float[Tensor, "b l w"],
        seen: Bool[Tensor, "b l"] | None = None,
        real: Bool[Tensor, "b t"] | None = None,
    ) -> Float[Tensor, "b t d"]:
        """Predict at one time for all rows or one per row; no frame sees those that `real` says are padding."""
        condition = condition + self.embed_time(time)[:, None]
        x = self.input_projection(x)
        if not self.encodes:
            frames = Rows.of(x, real)
            x = self._place(frames.pack(x), frames)
            for block in self.blocks:
                x = block(x, condition, seen, frames)
            return frames.pad(self.output(x))
        size = condition.shape[1]
        both = torch.cat((condition, x), dim=1)
        rows = Rows.of(both, _joined(seen, real, size, both.shape[1]))
        x = self._place(rows.pack(both), rows)
        return rows.pad(self.output(run(self.blocks, x, rows=rows)))[:, size:]

    def embed_time(self, time: Tensor) -> Float[Tensor, "n w"]:
        """Embed a single time (one row, broadcast later) or one time per row, as they are."""
        embedded = interleaved_embedding(time.reshape(-1), self.width)
        return self.time(embedded.to(self.input_projection.weight.dtype))

    def _place(self, x: Float[Tensor, "m w"], rows: Rows) -> Float[Tensor, "m w"]:
        positions = sinusoidal_positions(rows.real.shape[1], x.shape[1], x.device).to(x.dtype)
        return self.dropout(x + positions[rows.place])


def _joined(
    seen: Bool[Tensor, "b l"] | None, real: Bool[Tensor, "b t"] | None, size: int, total: int
) -> Bool[Tensor, "b n"] | None:
    """Join the masks over a condition of `size` rows and the frames behind it."""
    if seen is None:
        return None if real is None else F.pad(real, (size, 0), value=True)
    return F.pad(seen, (0, total - size), value=True) if real is None else torch.cat((seen, real), dim=1)

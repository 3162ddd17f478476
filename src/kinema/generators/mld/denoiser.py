"""Denoise the latents of a motion with MLD's transformer (MLD §2)."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from kinema.generators.frames.denoiser import Denoiser, Read
from kinema.nn.embeddings import timestep_embedding
from kinema.nn.rows import Rows
from kinema.nn.skip import SkipTransformer
from kinema.types import TextFeatures


class MldDenoiser(Denoiser):
    """Skip transformer over the latents, the time and the text, in this order; the latents are as wide as it is.

    `time_dim` is the width of the time's sinusoids, `positions` the size of the learned table.
    """

    def __init__(
        self,
        *,
        text_dim: int,
        width: int = 256,
        feedforward: int = 1024,
        layers: int = 9,
        heads: int = 4,
        dropout: float = 0.1,
        time_dim: int = 768,
        positions: int = 500,
    ) -> None:
        super().__init__()
        self.time_dim = time_dim
        self.time = nn.Sequential(nn.Linear(time_dim, width), nn.SiLU(), nn.Linear(width, width))
        self.text_projection = nn.Linear(text_dim, width)
        self.positions = nn.Parameter(torch.rand(positions, width))
        self.encoder = SkipTransformer(width, heads, feedforward, layers, dropout)

    def read(self, text: TextFeatures) -> Read:
        """Project the pooled vector, of which the published model keeps the positive part alone."""
        return self.text_projection(text.pooled.relu())[:, None], None

    def forward(
        self,
        x: Float[Tensor, "b t d"],
        time: Tensor,
        condition: Float[Tensor, "b l w"],
        seen: Bool[Tensor, "b m"] | None = None,
        real: Bool[Tensor, "b t"] | None = None,
    ) -> Float[Tensor, "b t d"]:
        """Predict at one time for all rows or one per row; there is no padding to be masked."""
        size = x.shape[1]
        time = self.embed_time(time)[:, None].expand(len(x), -1, -1)
        sequence = torch.cat((x, time, condition), dim=1)
        rows = Rows.of(sequence)
        return rows.pad(self.encoder(rows.pack(sequence + self.positions[: sequence.shape[1]]), rows))[:, :size]

    def embed_time(self, time: Tensor) -> Float[Tensor, "n w"]:
        """Embed a single time (one row, broadcast later) or one time per row."""
        return self.time(timestep_embedding(time.reshape(-1), self.time_dim).to(self.positions.dtype))

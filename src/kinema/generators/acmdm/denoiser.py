"""Denoise absolute joints, or the latents of each, with ACMDM's transformer (FRONTIER §3)."""

from __future__ import annotations

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional as F

from kinema.generators.frames.denoiser import Denoiser, Read
from kinema.nn.embeddings import timestep_embedding
from kinema.nn.modulation import modulate
from kinema.nn.norms import RMSNorm
from kinema.nn.rows import Rows
from kinema.nn.streams import CrossBlock, Modulation, initialize
from kinema.types import TextFeatures

FREQUENCIES = 256


def rotary_base(tokens: int) -> float:
    """Return the base of the rotary embedding of sequences of so many tokens: (floor(8 L / (100 pi)) + 1) * 100."""
    return 100.0 * (math.floor(8 * tokens / (100 * math.pi)) + 1)


class AcmdmDenoiser(Denoiser):
    """Transformer over patches of `patch` joints of one latent frame each, under the time and the pooled text.

    A latent frame has `channels` numbers for each of `joints` joints, side by side; its patches follow each other, and
    a sequence has at most `most` latent frames. All blocks and the output are modulated by time and text (adaLN-zero).
    """

    def __init__(
        self,
        *,
        joints: int,
        channels: int,
        patch: int,
        most: int,
        text_dim: int,
        width: int = 512,
        layers: int = 8,
        heads: int = 8,
    ) -> None:
        super().__init__()
        if joints % patch:
            fitting = ", ".join(str(size) for size in range(1, joints + 1) if joints % size == 0)
            raise ValueError(f"patch={patch} does not divide {joints} joints; choose one of {fitting}")
        self.patches, size = joints // patch, patch * channels
        self.base = rotary_base(most * self.patches)
        self.motion_in = nn.Linear(size, width)
        self.time = nn.Sequential(nn.Linear(FREQUENCIES, width), nn.SiLU(), nn.Linear(width, width))
        self.text_projection = nn.Linear(text_dim, width)
        self.blocks = nn.ModuleList(CrossBlock(width, heads, 8 * width // 3) for _ in range(layers))
        self.norm = RMSNorm(width)
        self.modulation = Modulation(width, 2)
        self.motion_out = nn.Linear(width, size)
        self.reset_parameters()

    def reset_parameters(self) -> None:
        """Initialise: Xavier-uniform Linears, N(0, .02) time and text, zero modulations and output."""
        initialize(self)
        for module in (*self.time, self.text_projection):
            if isinstance(module, nn.Linear):
                nn.init.normal_(module.weight, std=0.02)
        nn.init.zeros_(self.motion_out.weight)

    def read(self, text: TextFeatures) -> Read:
        """Project the pooled vector."""
        return self.text_projection(text.pooled)[:, None], None

    def forward(
        self,
        x: Float[Tensor, "b t d"],
        time: Tensor,
        condition: Float[Tensor, "b l w"],
        seen: Bool[Tensor, "b m"] | None = None,
        real: Bool[Tensor, "b t"] | None = None,
    ) -> Float[Tensor, "b t d"]:
        """Predict at one time for all rows or one per row; no latent sees those that `real` says are padding."""
        shown = torch.ones_like(x[..., 0], dtype=torch.bool) if real is None else real
        rows = Rows(shown.repeat_interleave(self.patches, dim=1))
        tokens = self.motion_in(rows.pack(x.unflatten(2, (self.patches, -1)).flatten(1, 2)))
        embedded = timestep_embedding(time.reshape(-1), FREQUENCIES).to(tokens.dtype)
        c = F.silu(self.time(embedded) + condition[:, 0])
        for block in self.blocks:
            tokens = block(tokens, rows, c, base=self.base)
        shift, scale = self.modulation(c, rows)
        out = self.motion_out(modulate(self.norm(tokens), shift, scale))
        return rows.pad(out).unflatten(1, (-1, self.patches)).flatten(2)

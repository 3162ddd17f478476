"""Quantise vectors by a codebook that learns by gradients, as the VQ-VAE's equations have it."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from kinema.nn.ranks import gather_rows
from kinema.options import Classes, Size, checked
from kinema.registry import buildable
from kinema.tokenizers.codebook import Quantized, assign, look_up, perplexity


@buildable
class GradientCodebook(nn.Module):
    """Vector quantiser whose codes are parameters, drawn to what chose them by ||sg(z) - e||^2 (VQ-VAE, Eq. 3).

    What BAD's Eq. 1 writes, where the published code takes running means (`EMACodebook`); nothing revives dead codes.
    """

    quantizers = 1

    @checked
    def __init__(self, codebook_size: Classes = 512, code_dim: Size = 512) -> None:
        super().__init__()
        self.codebook_size, self.code_dim = codebook_size, code_dim
        self.codebook = nn.Parameter(
            torch.empty(codebook_size, code_dim).uniform_(-1 / codebook_size, 1 / codebook_size)
        )

    @property
    def codebooks(self) -> Float[Tensor, "1 k d"]:
        """The code vectors of the one layer."""
        return self.codebook.detach()[None]

    def forward(
        self,
        z: Float[Tensor, "b n d"],
        real: Bool[Tensor, "b n"],
        generator: torch.Generator | None = None,
        shard: tuple[int, int] = (0, 1),
    ) -> Quantized:
        """Quantise by the nearest codes; nothing is drawn."""
        with torch.autocast(z.device.type, enabled=False):
            mask = real[..., None]
            z = z.float().masked_fill(~mask, 0)
            codes = assign(z.detach(), self.codebook.detach()).masked_fill(~real, 0)
            nearest = self.codebook[codes]
            count = (mask.sum() * self.code_dim).clamp(min=1)
            chosen = gather_rows(codes[real], shard[1] if self.training else 1)
            used = torch.bincount(chosen, minlength=self.codebook_size) > 0
            return Quantized(
                values=(z + (nearest - z).detach()) * mask,
                codes=codes[..., None],
                commit=((z - nearest.detach()).square() * mask).sum() / count,
                perplexity=perplexity(chosen, self.codebook_size),
                dead_codes=(~used).float().mean(),
                embedding=((z.detach() - nearest).square() * mask).sum() / count,
            )

    def lookup(self, codes: Int[Tensor, "b n 1"]) -> Float[Tensor, "b n d"]:
        """Return the vectors of codes, zeros for -1; raises ValueError for an id out of range."""
        return look_up(codes, self.codebook.detach())

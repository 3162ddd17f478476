"""Say what a tokenizer owes whose latents are drawn: the moments that they are drawn from."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from kinema.tokenizers import MotionTokenizer
from kinema.types import Latents, MotionBatch


class PosteriorTokenizer(MotionTokenizer):
    """Map motion to a normal distribution over latents (a VAE).

    The same motion always has the same moments, so that they can be cached, and latents be drawn from them anew.
    """

    deterministic = False

    @abstractmethod
    def moments(self, motion: MotionBatch) -> Latents:
        """Return the mean and the log variance of each latent, side by side: values (b, n, 2 width)."""

    def encode(self, motion: MotionBatch, *, generator: torch.Generator | None = None) -> Latents:
        """Draw latents; without a generator return their means."""
        return draw(self.moments(motion), generator)


def draw(moments: Latents, generator: torch.Generator | None, shard: tuple[int, int] = (0, 1)) -> Latents:
    """Draw latents from moments (without a generator: their means), for the global batch that `shard` is of."""
    mean, log_variance = split(moments)
    if generator is None:
        return replace(moments, values=mean)
    return replace(moments, values=mean + (log_variance / 2).exp() * standard_noise(mean, generator, shard))


def split(moments: Latents) -> tuple[Float[Tensor, "b n c"], Float[Tensor, "b n c"]]:
    """Return the means and the log variances."""
    mean, log_variance = moments.content.chunk(2, dim=-1)
    return mean, log_variance


def standard_noise(
    like: Float[Tensor, "b n c"], generator: torch.Generator | None, shard: tuple[int, int]
) -> Float[Tensor, "b n c"]:
    """Draw for the global batch, of which this is the part `shard` = (rank, world), and take the own share."""
    (rank, world), rows = shard, len(like)
    noise = torch.randn(world * rows, *like.shape[1:], generator=generator, device=like.device, dtype=like.dtype)
    return noise[rank * rows : (rank + 1) * rows]

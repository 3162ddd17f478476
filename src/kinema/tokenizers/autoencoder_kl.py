"""Compress motion four-fold in time into latents that are drawn: MARDM's autoencoder as a VAE (an ablation)."""

from __future__ import annotations

from typing import Annotated

import torch

from kinema.motion.representation import Representation
from kinema.options import Depth, Levels, NonNegative, OneOf, OpenShare, Size, checked
from kinema.registry import buildable
from kinema.tokenizers.autoencoder import ERRORS, AutoEncoder, mean_of_real
from kinema.tokenizers.posterior import PosteriorTokenizer, split, standard_noise
from kinema.types import Latents, Losses, MotionBatch


@buildable
class AutoEncoderKL(PosteriorTokenizer, AutoEncoder):
    """Encode motion (b, t, d) to normal distributions over latents (b, t // 4, latent_dim), and back.

    The autoencoder of MARDM whose encoder gives means and log variances; `kl_weight` is that of their divergence from
    N(0, 1), by default MLD's. MARDM's ablation "AE -> VAE" in our reading: the paper doesn't define it.
    """

    outputs = 2

    @checked
    def __init__(
        self,
        representation: Representation,
        *,
        width: Size = 512,
        latent_dim: Size = 512,
        depth: Depth = 3,
        dilation_growth: Size = 3,
        down_levels: Levels = 2,
        dropout: OpenShare = 0.2,
        joint_weight: NonNegative = 1.0,
        root_weight: NonNegative = 0.0,
        error: Annotated[str, OneOf(ERRORS)] = "smooth_l1",
        mask_padding: bool = True,
        kl_weight: NonNegative = 1e-4,
    ) -> None:
        super().__init__(
            representation,
            width=width,
            latent_dim=latent_dim,
            depth=depth,
            dilation_growth=dilation_growth,
            down_levels=down_levels,
            dropout=dropout,
            joint_weight=joint_weight,
            root_weight=root_weight,
            error=error,
            mask_padding=mask_padding,
        )
        self.kl_weight = kl_weight

    def loss(
        self, motion: MotionBatch, *, generator: torch.Generator | None = None, shard: tuple[int, int] = (0, 1)
    ) -> Losses:
        """Return the autoencoder's losses of drawn latents, and the divergence, a mean over real latents and dims."""
        moments = self.moments(motion)
        mean, log_variance = split(moments)
        z = mean + (log_variance / 2).exp() * standard_noise(mean, generator, shard)
        losses = self._losses(z, self.representation.normalize(motion.features, motion.lengths), motion.lengths)
        divergence = mean_of_real((mean.square() + log_variance.exp() - 1 - log_variance) / 2, moments.mask)
        return {**losses, "loss": losses["loss"] + self.kl_weight * divergence, "kl": divergence}

    def moments(self, motion: MotionBatch) -> Latents:
        """Encode a batch as the autoencoder does: a tail of fewer than four frames is dropped."""
        return AutoEncoder.encode(self, motion)

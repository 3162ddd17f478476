"""Corrupt latents for the training of the masked autoregressive model, every draw in one injectable value."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor

from kinema.diffusion.ddpm import DDPM
from kinema.diffusion.flow import Flow
from kinema.generators.draws import StepDraws
from kinema.masking import cosine_ratio, masked_count

MASK_RATIOS = ("cosine", "all")


@dataclass
class MarDraws(StepDraws):
    """Hold what a training step draws, over all `n` positions whether they end up masked or not."""

    mask_time: Float[Tensor, " b"]
    permutation: Int[Tensor, "b n"]
    to_noise: Bool[Tensor, "b n"]
    to_mask: Bool[Tensor, "b n"]
    corruption: Float[Tensor, "b n c"]
    condition_drop: Bool[Tensor, " b"]
    diffusion_time: Shaped[Tensor, "b n k"]
    diffusion_noise: Float[Tensor, "b n k c"]

    @classmethod
    def draw(
        cls,
        shape: tuple[int, int, int],
        process: DDPM | Flow,
        *,
        repeats: int,
        noise_share: float = 0.1,
        mask_share: float = 0.88,
        condition_drop: float,
        generator: torch.Generator | None,
        device: torch.device,
    ) -> MarDraws:
        """Draw for `shape` = (samples, positions, channels), `repeats` times and noises per position."""
        batch, positions, channels = shape

        def uniform(*size: int) -> Tensor:
            return torch.rand(size, generator=generator, device=device)

        def normal(*size: int) -> Tensor:
            return torch.randn(size, generator=generator, device=device)

        return cls(
            mask_time=uniform(batch),
            permutation=uniform(batch, positions).argsort(dim=1),
            to_noise=uniform(batch, positions) < noise_share,
            to_mask=uniform(batch, positions) < mask_share,
            corruption=normal(batch, positions, channels),
            condition_drop=uniform(batch) < condition_drop,
            diffusion_time=process.draw_times((batch, positions, repeats), generator, device),
            diffusion_noise=normal(batch, positions, repeats, channels),
        )


def training_mask(draws: MarDraws, real: Bool[Tensor, "b n"], counted: Int[Tensor, " #b"]) -> Bool[Tensor, "b n"]:
    """Mask n = max(1, round(counted * cos(pi u / 2))) of the permuted positions, and of these the real ones."""
    count = masked_count(counted, cosine_ratio(draws.mask_time))
    return (draws.permutation < count[:, None]) & real


def corrupt(
    latents: Float[Tensor, "b n c"], mask: Bool[Tensor, "b n"], mask_latent: Float[Tensor, " c"], draws: MarDraws
) -> Float[Tensor, "b n c"]:
    """Replace masked latents: some (10 %) by noise, 88 % of the others by the mask latent; the rest stay (MARDM §4)."""
    noised = mask & draws.to_noise
    hidden = mask & ~draws.to_noise & draws.to_mask
    latents = torch.where(noised[..., None], draws.corruption.to(latents.dtype), latents)
    return torch.where(hidden[..., None], mask_latent.to(latents.dtype), latents)

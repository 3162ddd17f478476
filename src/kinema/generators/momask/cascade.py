"""Generate in two stages: any generator of base tokens, then a residual transformer for the other layers."""

from __future__ import annotations

from typing import Any

import torch
from jaxtyping import Int
from torch import Tensor, nn

from kinema.generators.momask.residual import ResidualSampling, ResidualTransformer
from kinema.types import Known, Latents, Losses, TextFeatures


class Cascade(nn.Module):
    """Let a residual transformer complete what a base generator makes (MoMask §4).

    `sampling` is the base's; its `residual_*` options, where it has them, are the residual transformer's.
    """

    def __init__(self, base: nn.Module, residual: ResidualTransformer) -> None:
        super().__init__()
        check_stages(base, residual)
        self.base = base
        self.residual = residual
        self.codebook_size = base.codebook_size
        self.quantizers = residual.quantizers
        self.downsample = base.downsample
        self.max_latents = base.max_latents
        self.predicts_length = base.predicts_length
        self.sampling = base.sampling

    def loss(
        self,
        latents: Latents,
        text: TextFeatures,
        *,
        generator: torch.Generator | None = None,
        shard: tuple[int, int] = (0, 1),
    ) -> Losses:
        """Return the sum of both losses (each stage is normally trained by itself)."""
        base = self.base.loss(latents, text, generator=generator, shard=shard)["loss"]
        residual = self.residual.loss(latents, text, generator=generator, shard=shard)["loss"]
        return {"loss": base + residual, "base": base, "residual": residual}

    def sample(
        self,
        text: TextFeatures,
        frames: Int[Tensor, " b"] | None,
        *,
        seeds: Int[Tensor, " b"],
        known: Known | None = None,
        sampling: Any | None = None,
    ) -> Latents:
        """Generate all codes for `frames` frames, or edit: kept positions keep the codes of every layer."""
        sampling = sampling or self.sampling
        base = self.base.sample(text, frames, seeds=seeds, known=known, sampling=sampling)
        return self.residual.complete(base, text, seeds=seeds, known=known, sampling=ResidualSampling.of(sampling))


STAGES_AGREE = ("codebook_size", "max_latents", "downsample")


def check_stages(base: nn.Module, residual: nn.Module) -> None:
    """Raise ValueError if a residual transformer cannot complete what a base generator makes."""
    if base.quantizers != 1:
        raise ValueError(f"the base makes {base.quantizers} codes per position; give one that makes 1")
    for name in STAGES_AGREE:
        if getattr(base, name) != getattr(residual, name):
            raise ValueError(
                f"{name} is {getattr(base, name)} in the base and {getattr(residual, name)} in the residual "
                "transformer; train both on the same tokenizer"
            )

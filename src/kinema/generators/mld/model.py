"""Generate the latents of a motion as MLD does: a transformer denoises them all at once (MLD §2)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from kinema.diffusion.ddpm import DDPM
from kinema.diffusion.errors import per_sequence
from kinema.diffusion.flow import Flow
from kinema.generators.frames.generator import SequenceDiffusion
from kinema.generators.frames.sampling import DiffusionSampling
from kinema.generators.mld.denoiser import MldDenoiser
from kinema.options import Depth, OpenShare, Share, Size, checked
from kinema.registry import buildable
from kinema.types import LatentSpace, TextFeatures


@buildable
@dataclass(frozen=True)
class LatentSampling(DiffusionSampling):
    """Choose how latents are sampled, as any sequence."""


@buildable
class MLD(SequenceDiffusion):
    """Motion latent diffusion (MLD §2): `latents` of `latent_dim` dims stand for a motion of any length.

    Guidance starts from the features of the empty text, which the model keeps (`take_empty_text`).
    """

    denoiser: MldDenoiser
    empty_text: Float[Tensor, " c"]

    @checked
    def __init__(
        self,
        *,
        text_dim: Size,
        process: DDPM | Flow,
        latents: Size = 1,
        latent_dim: Size = 256,
        feedforward: Size = 1024,
        layers: Depth = 9,
        heads: Size = 4,
        dropout: OpenShare = 0.1,
        time_dim: Size = 768,
        positions: Size = 500,
        condition_drop: Share = 0.1,
        sampling: LatentSampling | None = None,
    ) -> None:
        denoiser = MldDenoiser(
            text_dim=text_dim,
            width=latent_dim,
            feedforward=feedforward,
            layers=layers,
            heads=heads,
            dropout=dropout,
            time_dim=time_dim,
            positions=positions,
        )
        super().__init__(
            denoiser,
            process,
            space=LatentSpace("continuous", latent_dim, latents, unit=None),
            condition_drop=condition_drop,
            mask_frames=False,
            average=per_sequence,
            sampling=sampling or LatentSampling(guidance=7.5, solver="ddim", solver_steps="leading50"),
        )
        self.text_dim = text_dim
        self.register_buffer("empty_text", torch.full((text_dim,), torch.nan))

    @property
    def lacks_empty_text(self) -> bool:
        """Whether the features of the empty text are yet to be given."""
        return bool(self.empty_text.isnan().any())

    def take_empty_text(self, text: TextFeatures) -> None:
        """Keep the pooled vector of the empty text."""
        self.empty_text.copy_(text.pooled[0])

    def without_text(self, text: TextFeatures, drop: Bool[Tensor, " b"] | None = None) -> TextFeatures:
        """Give the samples in `drop` (None: all) the empty text; raises ValueError if its features are not known."""
        if self.lacks_empty_text:
            raise ValueError("this MLD has no features of the empty text; give it those by take_empty_text")
        empty = self.empty_text.expand_as(text.pooled).to(text.pooled)
        return replace(text, pooled=empty if drop is None else torch.where(drop[:, None], empty, text.pooled))

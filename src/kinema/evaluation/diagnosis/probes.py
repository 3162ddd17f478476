"""Lay a generator's denoiser open: the clean rows it was trained to find, and its prediction from noisy ones."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from kinema.diffusion.ddpm import DDPM
from kinema.diffusion.guidance import Predict
from kinema.generators import Generator
from kinema.generators.frames.generator import FrameDiffusion
from kinema.generators.mar.model import MARDM
from kinema.nn.mode import inference
from kinema.types import Latents, TextFeatures, frame_mask


@dataclass(frozen=True)
class Probe:
    """Hold clean rows, which of their positions are real, and `predict(x, time)` under the rows' own texts."""

    process: DDPM
    clean: Float[Tensor, "n *d"]
    real: Bool[Tensor, "n *k"]
    predict: Predict

    def columns(self, values: Float[Tensor, "n *d"]) -> Float[Tensor, "m c"]:
        """Return the real positions of values shaped as the clean rows."""
        return values[self.real]


def probe(generator: Generator, latents: Latents, text: TextFeatures) -> Probe:
    """Probe a method on frames, or a MARDM whose every latent is masked, without guidance.

    Raises ValueError for a generator that doesn't diffuse by DDPM.
    """
    with inference(generator):
        match generator, latents.values:
            case FrameDiffusion(process=DDPM() as process), Tensor() as values:
                return _frames(generator, process, values, latents, text)
            case MARDM(process=DDPM() as process), Tensor() as values:
                return _latents(generator, process, values, latents, text)
    raise ValueError(f"{type(generator).__name__} doesn't predict by DDPM; choose mdm, motiondiffuse or mardm_ddpm")


def _frames(generator: FrameDiffusion, process: DDPM, values: Tensor, latents: Latents, text: TextFeatures) -> Probe:
    size = values.shape[1] if generator.mask_frames else generator.space.most
    clean, real = F.pad(values, (0, 0, 0, size - values.shape[1])), frame_mask(latents.lengths, size)
    condition, seen = generator.denoiser.read(text)
    shown = real if generator.mask_frames else None

    def predict(x: Tensor, time: Tensor) -> Tensor:
        with inference(generator):
            return generator.denoiser(x, time, condition, seen, shown)

    return Probe(process, clean, real, predict)


def _latents(generator: MARDM, process: DDPM, values: Tensor, latents: Latents, text: TextFeatures) -> Probe:
    hidden = generator.mask_latent.expand_as(values) * latents.mask[..., None]
    condition = generator.mlp.embed_condition(generator(hidden, text, latents.mask)[latents.mask])
    clean = values[latents.mask]

    def predict(x: Tensor, time: Tensor) -> Tensor:
        with inference(generator):
            return generator.mlp.denoise(x, generator.mlp.embed_time(time), condition)

    return Probe(process, clean, torch.ones(len(clean), dtype=torch.bool, device=clean.device), predict)

"""MARDM: masked autoregression over continuous latents with a diffusion MLP per latent."""

from kinema.generators.mar.model import MARDM
from kinema.generators.mar.sampling import MarSampling

__all__ = ["MARDM", "MarSampling"]

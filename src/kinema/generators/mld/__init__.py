"""MLD: diffusion on the few latents in which a variational autoencoder says a whole motion."""

from kinema.generators.mld.model import MLD, LatentSampling

__all__ = ["MLD", "LatentSampling"]

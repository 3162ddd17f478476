"""MoMask: masked modelling of base codes, and the residual transformer that completes them."""

from kinema.generators.momask.cascade import Cascade
from kinema.generators.momask.model import MoMask, MoMaskSampling
from kinema.generators.momask.residual import ResidualSampling, ResidualTransformer

__all__ = ["Cascade", "MoMask", "MoMaskSampling", "ResidualSampling", "ResidualTransformer"]

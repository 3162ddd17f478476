"""MoMask: masked modelling of base codes, which a residual transformer completes."""

from kinema.generators.momask.model import MoMask, MoMaskSampling

__all__ = ["MoMask", "MoMaskSampling"]

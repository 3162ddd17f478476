"""MotionDiffuse: diffusion on frames by a transformer of stylised branches that predicts the noise."""

from kinema.generators.frames.sampling import FrameSampling
from kinema.generators.motiondiffuse.model import MotionDiffuse

__all__ = ["FrameSampling", "MotionDiffuse"]

"""MDM: diffusion on frames by a transformer that predicts the clean motion."""

from kinema.generators.frames.sampling import FrameSampling
from kinema.generators.mdm.model import MDM

__all__ = ["MDM", "FrameSampling"]

"""ACMDM: a flow on absolute joints, or on latents of each, by a transformer."""

from kinema.generators.acmdm.model import ACMDM
from kinema.generators.frames.sampling import FrameSampling

__all__ = ["ACMDM", "FrameSampling"]

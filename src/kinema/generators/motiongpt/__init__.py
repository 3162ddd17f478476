"""MotionGPT: motion as a foreign language, a T5 from prompts to strings of motion tokens."""

from kinema.generators.motiongpt.model import MotionGPT, MotionGPTSampling

__all__ = ["MotionGPT", "MotionGPTSampling"]

"""T2M-GPT, and AttT2M with attention to words: codes from left to right."""

from kinema.generators.gpt.model import T2MGPT
from kinema.generators.gpt.sampling import GptSampling

__all__ = ["T2MGPT", "GptSampling"]

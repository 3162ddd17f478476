"""ReMoDiffuse: diffusion on frames that reads, beside the text, motions retrieved from the training split."""

from kinema.generators.remodiffuse.database import RetrievalDatabase
from kinema.generators.remodiffuse.mixture import MixtureSampling
from kinema.generators.remodiffuse.model import ReMoDiffuse

__all__ = ["MixtureSampling", "ReMoDiffuse", "RetrievalDatabase"]

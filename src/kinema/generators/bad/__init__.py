"""BAD: masked modelling of codes in the order of a permutation."""

from kinema.generators.bad.model import BAD
from kinema.generators.bad.sampling import BadSampling

__all__ = ["BAD", "BadSampling"]

"""BAMM: codes from left to right, then between those that are kept."""

from kinema.generators.bamm.model import BAMM
from kinema.generators.bamm.sampling import BammSampling

__all__ = ["BAMM", "BammSampling"]

"""Turn text into motion, and edit motion: `TextToMotion` and what it alone needs."""

from kinema.pipeline.text_to_motion import TextToMotion

__all__ = ["TextToMotion"]

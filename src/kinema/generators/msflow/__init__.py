"""MSFlow: a flow directly in motion space, under the words of a text."""

from kinema.generators.frames.sampling import FrameSampling
from kinema.generators.msflow.model import MSFlow
from kinema.generators.msflow.physics import Physics
from kinema.generators.msflow.shortcut import Shortcut, ShortcutSampling

__all__ = ["FrameSampling", "MSFlow", "Physics", "Shortcut", "ShortcutSampling"]

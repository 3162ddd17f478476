"""Train, compare and use text-to-motion methods."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

# Before torch is loaded: OpenMP threads that spin while others hold the cores make a busy machine 30 times slower.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

__version__ = "0.1.0"
__all__ = ["TextToMotion", "__version__"]

if TYPE_CHECKING:
    from kinema.pipeline.text_to_motion import TextToMotion


def __getattr__(name: str) -> Any:
    # Imported on first use: `import kinema` (and every --help) must not pay for torch.
    if name == "TextToMotion":
        from kinema.pipeline.text_to_motion import TextToMotion

        return TextToMotion
    raise AttributeError(f"module 'kinema' has no attribute {name!r}")

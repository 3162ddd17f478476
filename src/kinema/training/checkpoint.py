"""Write checkpoints atomically and read them without executing anything."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import torch
from lightning.pytorch.plugins.io import TorchCheckpointIO

from kinema.atomic import replacing


class AtomicCheckpointIO(TorchCheckpointIO):
    """Save through a temporary file and a rename; load plain containers only."""

    def save_checkpoint(self, checkpoint: dict[str, Any], path: str | Path, storage_options: Any = None) -> None:
        """Write the checkpoint so that a reader sees the old file or the new one, never a part."""
        try:
            with replacing(path, sole=True, sync=True) as temporary, open(temporary, "wb") as file:
                torch.save(checkpoint, file)
        except (OSError, RuntimeError) as error:
            # torch's zip writer reports a full disk as a RuntimeError without an errno.
            raise OSError(
                f"could not write checkpoint {path}: {error}; the previous checkpoint is untouched. Free disk space "
                "and run the same command again: it resumes"
            ) from error

    def load_checkpoint(self, path: str | Path, map_location: Any = None, weights_only: bool | None = True) -> Any:
        """Read a checkpoint; a truncated one is named together with what to do."""
        try:
            return torch.load(path, map_location=map_location or "cpu", weights_only=True)
        except (RuntimeError, EOFError, OSError, ValueError, pickle.UnpicklingError) as error:
            raise ValueError(
                f"checkpoint {path} cannot be read ({error}); delete it to train this stage from the start"
            ) from error

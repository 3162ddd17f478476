"""Write checkpoints atomically and read them without executing anything."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from lightning.pytorch.plugins.io import TorchCheckpointIO
from torch import Tensor

from kinema.atomic import replacing
from kinema.files.checkpoints import read_torch
from kinema.files.json import fault
from kinema.files.kinds import refuse

CONTENT = {
    "pytorch-lightning_version": str,
    "epoch": int,
    "global_step": int,
    "state_dict": dict,
    "loops": dict,
    "callbacks": dict,
    "optimizer_states": list,
    "lr_schedulers": list,
}
"""What Lightning resumes from."""


class AtomicCheckpointIO(TorchCheckpointIO):
    """Save through a temporary file and a rename; load plain containers only, of a model with tensors like `model`."""

    def __init__(self, model: Mapping[str, Tensor]) -> None:
        self.shapes = {name: value.shape for name, value in model.items()}

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
        """Read a checkpoint; one that is damaged or of another model is named together with what to do."""
        fix = "delete it to train this stage from the start"
        content = read_torch(path, device=map_location or "cpu", mapped=False, fix=fix)
        if wrong := fault(content, CONTENT):
            raise refuse(path, wrong, fix)
        found = {name: getattr(value, "shape", None) for name, value in content["state_dict"].items()}
        if found != self.shapes:
            names = sorted(found.keys() | self.shapes.keys(), key=str)
            odd = [name for name in names if found.get(name) != self.shapes.get(name)]
            raise refuse(path, f"is of another model: {', '.join(map(str, odd[:3]))} differ", fix)
        return content

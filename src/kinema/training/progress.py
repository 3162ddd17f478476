"""Show how far a run is: step, time left, loss."""

from __future__ import annotations

from lightning.pytorch.callbacks import RichProgressBar


class StepProgress(RichProgressBar):
    """Count steps (a run is one long epoch) and show the losses that matter on one line."""

    def _get_train_description(self, current_epoch: int) -> str:
        return "train"

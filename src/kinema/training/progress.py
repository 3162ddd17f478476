"""Show how far a run is: step, time left, loss."""

from __future__ import annotations

from typing import Any

from lightning.pytorch import LightningModule, Trainer
from lightning.pytorch.callbacks import ProgressBar, RichProgressBar, TQDMProgressBar
from lightning.pytorch.callbacks.progress.tqdm_progress import Tqdm


class Steps(ProgressBar):
    """Count steps of the run: a resumed one has fewer batches before it than steps."""

    @property
    def total_train_batches(self) -> int:
        """Return the steps of the whole run."""
        return self.trainer.max_steps

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Show the step that is done."""
        super().on_train_batch_end(trainer, pl_module, outputs, batch, trainer.global_step - 1)


class StepProgress(Steps, RichProgressBar):
    """Count steps (a run is one long epoch) and show the losses that matter on one line."""

    def _get_train_description(self, current_epoch: int) -> str:
        return "train"


class PlainProgress(Steps, TQDMProgressBar):
    """Count steps on a plain line."""

    def init_train_tqdm(self) -> Tqdm:
        """Say how many steps there are: Lightning does so at an epoch's start, which a resumed run has behind it."""
        bar = super().init_train_tqdm()
        bar.total = self.total_train_batches
        return bar

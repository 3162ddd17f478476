"""Hold what happens around training steps: averaging, selection, checkpoints and the run's record."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

from lightning.pytorch import Callback, LightningModule, Trainer
from lightning.pytorch.callbacks import WeightAveraging
from torch import Tensor, nn
from torch.optim.swa_utils import get_ema_multi_avg_fn

from kinema.training.divergence import check_weights
from kinema.training.modules import StageModule
from kinema.training.pace import Pace
from kinema.training.record import Record


class EMA(WeightAveraging):
    """Average the parameters exponentially (buffers follow the model).

    `decay` is the published constant; with `warmup` it grows as (1+n)/(10+n), without which a short run would keep
    mostly its initialisation.
    """

    def __init__(self, decay: float, warmup: bool = True) -> None:
        super().__init__(use_buffers=False, multi_avg_fn=self._average)
        self.decay = decay
        self.warmup = warmup

    def _average(self, averages: Any, currents: Any, count: Tensor | int) -> None:
        """Move all parameters at once: one by one, each would ask the device for the count."""
        decay = self.decay
        if self.warmup:
            steps = int(count)
            decay = min(decay, (1 + steps) / (10 + steps))
        get_ema_multi_avg_fn(decay)(averages, currents, count)

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Follow the module to its device: Lightning copies it before it moves it."""
        if self._average_model is not None:
            self._average_model.to(pl_module.device)

    def averaged(self) -> StageModule:
        """Return the averaged copy of the module; there is one from the start of training on."""
        if self._average_model is None or not isinstance(self._average_model.module, StageModule):
            raise ValueError("nothing is averaged before training has started")
        return self._average_model.module


def selected(trainer: Trainer, module: LightningModule) -> nn.Module:
    """Return the model that is validated and kept: the averaged one where there is averaging."""
    averaging = [c for c in trainer.callbacks if isinstance(c, EMA)]  # type: ignore[attr-defined]  # set by its connector
    source = averaging[0].averaged() if averaging else module
    if not isinstance(source, StageModule):
        raise TypeError(f"{type(source).__name__} is trained here, which holds no model; derive it from StageModule")
    return source.model


def selected_state(trainer: Trainer, module: LightningModule) -> dict[str, Tensor]:
    """Return the weights of the model that is validated and kept."""
    return {k: v.detach().cpu().clone() for k, v in selected(trainer, module).state_dict().items()}


def check_losses(module: LightningModule) -> None:
    """Raise DivergedError if a training loss was not finite; every rank calls this at the same steps."""
    if isinstance(module, StageModule):
        module.check_losses()


class Selection(Callback):
    """Keep the weights of the least value; they are part of the checkpoint, so a resumed run has them.

    `keeps` is the recipe's `select` that asks for them.
    """

    keeps: ClassVar[str]

    def __init__(self) -> None:
        super().__init__()
        self.value = float("inf")
        self.step = -1
        self.weights: dict[str, Tensor] = {}

    def consider(self, value: float, trainer: Trainer, pl_module: LightningModule) -> None:
        """Keep the weights if their value is less than the best one."""
        if value < self.value:
            self.value, self.step = value, trainer.global_step
            self.weights = selected_state(trainer, pl_module)

    def state_dict(self) -> dict[str, Any]:
        """Return the selection so far."""
        return {"value": self.value, "step": self.step, "weights": self.weights}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore the selection."""
        self.value, self.step, self.weights = state_dict["value"], state_dict["step"], state_dict["weights"]


class BestWeights(Selection):
    """Keep the weights with the least validation loss."""

    keeps = "best"

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Compare the validation loss with the best one."""
        if not trainer.sanity_checking:
            self.consider(float(trainer.callback_metrics.get("val/loss", float("nan"))), trainer, pl_module)


class Checkpoints(Callback):
    """Save `last.ckpt` every few steps (it must stand after the callbacks whose state it holds).

    At a step that is validated it waits for the validation: a run that dies in between validates again, so that its
    selection of weights is that of an uninterrupted run.
    """

    def __init__(self, path: Path, every: int, validated_every: int) -> None:
        self.path = path
        self.every = every
        self.validated_every = validated_every
        self.step = 0
        """The step that a run goes on from which ends now."""

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Remember what was resumed."""
        self.step = trainer.global_step

    def on_train_batch_end(self, trainer: Trainer, pl_module: LightningModule, *_: Any) -> None:
        """Save if it is time."""
        if trainer.global_step % self.every == 0 and trainer.global_step % self.validated_every:
            self._save(trainer, pl_module)

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Save what the validation selected."""
        if not trainer.sanity_checking:
            self._save(trainer, pl_module)

    def _save(self, trainer: Trainer, module: LightningModule) -> None:
        if trainer.global_step < trainer.max_steps:
            check_losses(module)
            check_weights(module, trainer.global_step)
            trainer.save_checkpoint(self.path)
            self.step = trainer.global_step


class RunRecord(Callback):
    """Record losses, learning rate, gradient norm and pace, and the seconds spent, over interruptions."""

    def __init__(self, record: Record, pace: Pace, every: int = 50) -> None:
        self.record, self.pace, self.every, self.shown = record, pace, every, False

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Drop what is of steps that will be run again."""
        if trainer.is_global_zero:
            self.record.rewind(trainer.global_step)
            self.shown = True
        self.pace.restart(trainer.global_step)

    def on_fit_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Show what there is where no step was left to run: dashboards start empty."""
        if trainer.is_global_zero and not self.shown:
            self.record.replay()

    def on_train_batch_end(self, trainer: Trainer, pl_module: LightningModule, *_: Any) -> None:
        """Record what training logs, every few steps."""
        if trainer.global_step % self.every == 0:
            # Reading the losses waits for the device: only then is the time that of the steps.
            values = _logged(trainer, "train/", "optim/")
            self._keep(trainer, values | self.pace.rates(trainer.global_step))

    def on_validation_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Stop the clock of training."""
        self.pace.start(Pace.ASIDE)

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Record the validation losses."""
        self.pace.stop(Pace.ASIDE)
        if not trainer.sanity_checking:
            self._keep(trainer, _logged(trainer, "val/"))

    def _keep(self, trainer: Trainer, values: dict[str, float]) -> None:
        if trainer.is_global_zero and values:
            self.record.scalars(trainer.global_step, values)

    def state_dict(self) -> dict[str, Any]:
        """Return the seconds spent so far."""
        return {"seconds": self.record.seconds}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore the seconds spent before the interruption."""
        self.record.spent = state_dict["seconds"]


def _logged(trainer: Trainer, *prefixes: str) -> dict[str, float]:
    return {k: float(v) for k, v in trainer.callback_metrics.items() if k.startswith(prefixes)}

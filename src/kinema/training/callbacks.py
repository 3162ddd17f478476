"""Hold what happens around training steps: averaging, selection, checkpoints, the run's record and its samples."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from lightning.pytorch import Callback, LightningModule, Trainer
from lightning.pytorch.callbacks import WeightAveraging
from lightning.pytorch.loggers import WandbLogger
from torch import Tensor, nn

from kinema.atomic import write_text
from kinema.runs.lines import append_line, read_lines
from kinema.training.modules import StageModule


class EMA(WeightAveraging):
    """Average the parameters exponentially (buffers follow the model).

    `decay` is the published constant; with `warmup` it grows as (1+n)/(10+n), without which a short run would keep
    mostly its initialisation.
    """

    def __init__(self, decay: float, warmup: bool = True) -> None:
        super().__init__(use_buffers=False, avg_fn=self._average)
        self.decay = decay
        self.warmup = warmup

    def _average(self, average: Tensor, current: Tensor, count: Tensor | int) -> Tensor:
        decay = min(self.decay, (1 + int(count)) / (10 + int(count))) if self.warmup else self.decay
        return torch.lerp(average, current, 1 - decay)

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


class BestWeights(Callback):
    """Keep the weights with the least validation loss; they are part of the checkpoint, so a resumed run has them."""

    def __init__(self) -> None:
        self.value = float("inf")
        self.step = -1
        self.weights: dict[str, Tensor] = {}

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Compare the validation loss with the best one."""
        value = float(trainer.callback_metrics.get("val/loss", float("nan")))
        if not trainer.sanity_checking and value < self.value:
            self.value, self.step = value, trainer.global_step
            self.weights = selected_state(trainer, pl_module)

    def state_dict(self) -> dict[str, Any]:
        """Return the selection so far."""
        return {"value": self.value, "step": self.step, "weights": self.weights}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore the selection."""
        self.value, self.step, self.weights = state_dict["value"], state_dict["step"], state_dict["weights"]


class Checkpoints(Callback):
    """Save `last.ckpt` every few steps (it must stand after the callbacks whose state it holds).

    At a step that is validated it waits for the validation: a run that dies in between validates again, so that its
    selection of weights is that of an uninterrupted run.
    """

    def __init__(self, path: Path, every: int, validated_every: int) -> None:
        self.path = path
        self.every = every
        self.validated_every = validated_every

    def on_train_batch_end(self, trainer: Trainer, *_: Any) -> None:
        """Save if it is time."""
        if trainer.global_step % self.every == 0 and trainer.global_step % self.validated_every:
            self._save(trainer)

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Save what the validation selected."""
        if not trainer.sanity_checking:
            self._save(trainer)

    def _save(self, trainer: Trainer) -> None:
        if trainer.global_step < trainer.max_steps:
            trainer.save_checkpoint(self.path)


class RunRecord(Callback):
    """Append metrics to `metrics.jsonl` and count the seconds spent, over interruptions."""

    def __init__(self, path: Path, every: int = 50) -> None:
        self.path = path
        self.every = every
        self.spent = 0.0
        self.started = time.monotonic()

    @property
    def seconds(self) -> float:
        """The seconds of training up to now, earlier parts of the run included."""
        return self.spent + time.monotonic() - self.started

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Drop the lines of steps that will be run again."""
        if not trainer.is_global_zero:
            return
        kept = [line for line in read_lines(self.path) if line["step"] <= trainer.global_step]
        write_text(self.path, "".join(json.dumps(line, sort_keys=True) + "\n" for line in kept))
        self.started = time.monotonic()

    def on_train_batch_end(self, trainer: Trainer, pl_module: LightningModule, *_: Any) -> None:
        """Record the training losses every few steps."""
        if trainer.global_step % self.every == 0:
            self._append(trainer, "train/")

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Record the validation losses."""
        if not trainer.sanity_checking:
            self._append(trainer, "val/")

    def _append(self, trainer: Trainer, prefix: str) -> None:
        if not trainer.is_global_zero:
            return
        values = {k: float(v) for k, v in trainer.callback_metrics.items() if k.startswith(prefix)}
        if values:
            append_line(self.path, {"step": trainer.global_step, "seconds": round(self.seconds, 2), **values})

    def state_dict(self) -> dict[str, Any]:
        """Return the seconds spent so far."""
        return {"seconds": self.seconds}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore the seconds spent before the interruption."""
        self.spent = state_dict["seconds"]


class Samples(Callback):
    """Write what the model makes of a few validation prompts, as a page that plays, and log it where wandb runs."""

    def __init__(self, folder: Path, every: int, draw: Callable[[Any, Path], Path | None]) -> None:
        self.folder = folder
        self.every = every
        self.draw = draw

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Draw with the validated weights."""
        if trainer.sanity_checking or not trainer.is_global_zero or trainer.global_step % self.every:
            return
        model = selected(trainer, pl_module)
        training = model.training
        model.eval()
        page = self.draw(model, self.folder / f"step-{trainer.global_step:07d}.html")
        model.train(training)
        for logger in trainer.loggers:
            if page is not None and isinstance(logger, WandbLogger):
                import wandb

                logger.experiment.log({"samples": wandb.Html(page.read_text())}, step=trainer.global_step)

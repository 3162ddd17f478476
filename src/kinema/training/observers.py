"""Look at a model while it trains, outside of its steps and without a trace in them: samples and scores."""

from __future__ import annotations

import copy
from abc import abstractmethod
from collections.abc import Callable
from typing import Any

from lightning.pytorch import Callback, LightningModule, Trainer
from lightning.pytorch.profilers import Profiler
from lightning.pytorch.utilities.seed import isolate_rng
from torch import nn

from kinema.runs.console import console
from kinema.training.callbacks import Selection, check_losses, selected, selected_state
from kinema.training.modules import StageModule
from kinema.training.pace import Pace
from kinema.training.record import Record


class Observer(Callback):
    """Look at the weights that would be kept (averaged ones where there is averaging), every few steps and at the last.

    It looks at a copy of its own, so that what is attached to a model to sample from it doesn't stay on the one that
    trains. The schedule is the observer's, whenever validation is.
    """

    def __init__(self, every: int) -> None:
        super().__init__()
        self.every = every
        self.copy: nn.Module | None = None

    def on_train_batch_end(self, trainer: Trainer, pl_module: LightningModule, *_: Any) -> None:
        """Look, if it is time."""
        step = trainer.global_step
        if step % self.every and step != trainer.max_steps:
            return
        check_losses(pl_module)
        if not trainer.is_global_zero:
            return
        profiler: Profiler = trainer.profiler  # type: ignore[attr-defined]  # set by its connector
        with profiler.profile(Pace.ASIDE), isolate_rng():
            if self.copy is None:
                self.copy = copy.deepcopy(selected(trainer, pl_module)).requires_grad_(False)
            self.copy.load_state_dict(selected_state(trainer, pl_module))
            self.look(trainer, pl_module, self.copy.eval())

    @abstractmethod
    def look(self, trainer: Trainer, pl_module: LightningModule, model: nn.Module) -> None:
        """Do what is to be done with the model of this step."""


class Samples(Observer):
    """Keep what the model makes of a few validation clips, and show it."""

    def __init__(self, every: int, record: Record, draw: Callable[[Any, int], dict[str, float]]) -> None:
        super().__init__(every)
        self.record, self.draw = record, draw

    def look(self, trainer: Trainer, pl_module: LightningModule, model: nn.Module) -> None:
        """Write the step's samples, show them, and keep the numbers that came with them."""
        step = trainer.global_step
        values = self.draw(model, step)
        for path in self.record.samples(step):
            self.record.show(path)
        if values:
            self.record.scalars(step, values)


class Scores(Observer, Selection):
    """Score the model on the validation split, and keep the weights of the least FID where the recipe asks for them."""

    keeps = "fid"

    def __init__(self, every: int, record: Record, score: Callable[[Any], dict[str, float]]) -> None:
        super().__init__(every)
        self.record, self.score = record, score

    def look(self, trainer: Trainer, pl_module: LightningModule, model: nn.Module) -> None:
        """Record the scores; a model whose motion can't be scored has none, and a note says why."""
        step = trainer.global_step
        try:
            scores = self.score(model)
        except ValueError as error:
            console.print(f"[yellow]note[/]      step {step} has no score: {error}")
            return
        self.record.scalars(step, {f"score/{name}": value for name, value in scores.items()})
        if isinstance(pl_module, StageModule) and pl_module.recipe.select == self.keeps:
            self.consider(scores["fid"], trainer, pl_module)

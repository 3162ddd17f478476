"""Hold the LightningModules: they wire batch -> loss -> log and nothing else.

Every draw of step s is a function of (seed, s): dropout through the global generators, seeded anew before each step
(per rank), all else through one generator that draws for the global batch, of which each rank takes its share. So a
resumed run, or one on more processes, sees the draws of an uninterrupted single one, and no RNG state has to be saved.
"""

from __future__ import annotations

from typing import Any, Protocol, cast, runtime_checkable

import torch
from lightning.pytorch import LightningModule
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from torch import Tensor, nn

from kinema.seeds import training_seed
from kinema.training.divergence import FirstLoss, check_loss
from kinema.training.recipe import Recipe
from kinema.types import Latents, Losses, MotionBatch, TextFeatures

FUSED = ("cpu", "cuda")
"""Where an optimiser's step is one kernel."""


class Unregistered:
    """Hold frozen helpers outside state_dict, EMA, DDP and checkpoints; copies share them."""

    def __init__(self, value: Any) -> None:
        self.value = value

    def __deepcopy__(self, memo: dict[int, Any]) -> Unregistered:
        return self


@runtime_checkable
class LatentSource(Protocol):
    """Return the latents of a batch of crops (encoded, or looked up).

    What is drawn comes from `generator`, for the batch that `shard` is of.
    """

    def __call__(
        self, batch: MotionBatch, generator: torch.Generator | None = None, shard: tuple[int, int] = (0, 1)
    ) -> Latents: ...


@runtime_checkable
class TextSource(Protocol):
    """Return the text features of strings."""

    def __call__(self, texts: list[str]) -> TextFeatures: ...


class StageModule(LightningModule):
    """Train one model by its recipe; subclasses say how a batch becomes losses."""

    model: Any  # an nn.Module with a loss, of motion or of latents and text

    def __init__(self, model: nn.Module, recipe: Recipe, seed: int) -> None:
        super().__init__()
        self.model = model
        self.recipe = recipe
        self.seed = seed
        self.call = Unregistered(None)
        self.first = FirstLoss()

    def losses(self, batch: MotionBatch, generator: torch.Generator, shard: tuple[int, int]) -> Losses:
        """Return the named losses of one batch."""
        raise TypeError(f"{type(self).__name__} is abstract: use MotionModule or GeneratorModule")

    def model_loss(self, *args: Any, **kwargs: Any) -> Losses:
        """Call the model's loss, compiled if asked for."""
        return (self.call.value or self.model.loss)(*args, **kwargs)

    def compile_loss(self) -> None:
        """Compile the loss (the state_dict keeps its names)."""
        self.call = Unregistered(torch.compile(self.model.loss))

    def _draws(self, *parts: int | str) -> torch.Generator:
        torch.manual_seed(training_seed(self.seed, self.global_rank, *parts))
        return torch.Generator(device=self.device).manual_seed(training_seed(self.seed, *parts))

    def training_step(self, batch: MotionBatch, batch_idx: int) -> Tensor:
        """Log the losses of a training batch and return the first.

        One that is not finite ends the training before anything of it is recorded or saved.
        """
        generator = self._draws("train", self.global_step)
        try:
            losses = self.losses(batch, generator, (self.global_rank, self.trainer.world_size))
        except (ValueError, RuntimeError):  # of numbers that weren't finite at a step before?
            self.first.check(lambda number: number)
            raise
        self.first.see(losses["loss"], self.global_step + 1)
        if (self.global_step + 1) % self.trainer.log_every_n_steps == 0:  # type: ignore[attr-defined]  # its connector's
            self.check_losses()
        self.log_dict({f"train/{k}": v.detach() for k, v in losses.items()}, batch_size=len(batch.lengths))
        if self.trainer.progress_bar_callback is not None:  # who shows a number waits for the device
            self.log("loss", losses["loss"].detach(), prog_bar=True, logger=False)
        return losses["loss"]

    def check_losses(self) -> None:
        """Raise DivergedError if a training loss was not finite, on any rank: all call this at the same steps."""
        self.first.check(lambda number: cast(Tensor, self.all_gather(number)))

    def on_validation_start(self) -> None:
        """Validate nothing that has diverged."""
        self.check_losses()

    def on_train_end(self) -> None:
        """Keep nothing that has diverged."""
        self.check_losses()

    def validation_step(self, batch: MotionBatch, batch_idx: int) -> None:
        """Log the mean validation losses; the draws are the same at every validation, and so is every rank's batch."""
        losses = self.losses(batch, self._draws("val", batch_idx), (0, 1))
        check_loss("validation", losses["loss"], self.global_step)
        for name, value in losses.items():
            self.log(f"val/{name}", value, batch_size=len(batch.lengths), prog_bar=name == "loss")

    def configure_optimizers(self) -> OptimizerLRScheduler:
        """Make the recipe's optimiser and its schedule by steps."""
        # Lightning leaves scaled gradients (16-mixed) to a fused step, and they would be clipped as they are.
        fused = self.device.type in FUSED and self.trainer.precision != "16-mixed"
        optimizer = self.recipe.optimizer(self.model.parameters(), fused=fused)
        # A plain function: of a bound method the schedule would write the attributes into every checkpoint.
        schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, lambda step: self.recipe.factor(step))
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}

    def configure_gradient_clipping(self, optimizer: torch.optim.Optimizer, *_: Any, **__: Any) -> None:
        """Clip the norm of all gradients, or of each named submodule by itself (T2M_EVALUATOR §4).

        The learning rate and the norm before clipping are logged at the steps that are recorded.
        """
        every = self.trainer.log_every_n_steps  # type: ignore[attr-defined]  # set by its connector
        if (self.global_step + 1) % every == 0:
            gradients = [p.grad for p in self.model.parameters() if p.grad is not None]
            norm = torch.nn.utils.get_total_norm(gradients)
            self.log_dict({"optim/lr": optimizer.param_groups[0]["lr"], "optim/grad_norm": norm})
        if self.recipe.clip is None:
            return
        parts = [self.model.get_submodule(name) for name in self.recipe.clip_each] or [self.model]
        for part in parts:
            torch.nn.utils.clip_grad_norm_(part.parameters(), self.recipe.clip)


class MotionModule(StageModule):
    """Train what reads batches of motion as they are: a tokenizer, or an evaluator of motion and its captions."""

    def losses(self, batch: MotionBatch, generator: torch.Generator, shard: tuple[int, int]) -> Losses:
        """Hand the batch to the model."""
        return self.model_loss(batch, generator=generator, shard=shard)


class GeneratorModule(StageModule):
    """Train a generator of latents; the frozen tokenizer and text encoder are held unregistered."""

    def __init__(self, model: nn.Module, recipe: Recipe, seed: int, latents: LatentSource, text: TextSource) -> None:
        super().__init__(model, recipe, seed)
        self.latents = Unregistered(latents)
        self.text = Unregistered(text)

    def losses(self, batch: MotionBatch, generator: torch.Generator, shard: tuple[int, int]) -> Losses:
        """Predict the latents of each motion from its caption."""
        with torch.no_grad():
            latents = self.latents.value(batch, generator, shard).to(self.device)
            text = self.text.value(batch.texts).to(self.device)
        text.clip_ids = batch.clip_ids
        return self.model_loss(latents, text, generator=generator, shard=shard)

"""Fit one module with Lightning and return its selected weights."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import torch
from lightning.pytorch import Callback, LightningDataModule, Trainer
from lightning.pytorch.callbacks import TQDMProgressBar
from torch import Tensor

from kinema.devices import ACCELERATORS
from kinema.training.callbacks import EMA, BestWeights, Checkpoints, RunRecord, Selection
from kinema.training.checkpoint import AtomicCheckpointIO
from kinema.training.modules import StageModule
from kinema.training.pace import Pace
from kinema.training.progress import StepProgress
from kinema.training.record import Record

HARMLESS = (
    "does not have many workers",
    "mid-epoch",
    "not stateful",
    "resumable",
    "LeafSpec",
    "in eval mode",
    "logging interval",
    "is not empty",
)
"""Warnings of Lightning that say nothing of our runs: data come from a map, and batches follow from the step."""

BARS = {"rich": StepProgress, "tqdm": TQDMProgressBar}


@dataclass(frozen=True)
class Machine:
    """Say where and how to run: nothing of it changes what is computed (beyond rounding)."""

    accelerator: str = "auto"
    devices: int | str | list[int] = 1
    num_nodes: int = 1
    strategy: str = "auto"
    precision: str = "32-true"
    compile: bool = False
    threads: int | None = None
    progress: str = "rich"
    log_every: int = 50
    extra: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.accelerator not in ACCELERATORS:
            raise ValueError(f"trainer.accelerator={self.accelerator!r}; allowed: {', '.join(ACCELERATORS)}")
        if self.progress not in (*BARS, "none"):
            raise ValueError(f"trainer.progress={self.progress!r}; allowed: {', '.join(BARS)}, none")

    def limit_threads(self) -> None:
        """Use this many CPU threads from now on (None: as many as torch takes)."""
        if self.threads is not None:
            torch.set_num_threads(self.threads)


@dataclass(frozen=True)
class Fitted:
    """Hold the selected weights, the step they are of and the seconds it took."""

    weights: dict[str, Tensor]
    step: int
    seconds: float
    val_loss: float | None


def fit(
    module: StageModule,
    data: LightningDataModule,
    folder: Path,
    machine: Machine,
    *,
    callbacks: Sequence[Callback] = (),
    record: Record | None = None,
) -> Fitted:
    """Train to the recipe's number of steps, resuming from `folder/checkpoints/last.ckpt` where that exists."""
    recipe = module.recipe
    # Lightning's notes on devices and its advertisement would bury what the run says itself.
    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)
    best, pace, record = BestWeights(), Pace(), record or Record(folder)
    keepers = {other.keeps: other for other in (best, *callbacks) if isinstance(other, Selection)}
    if recipe.select not in ("last", *keepers):
        raise ValueError(f"train.select={recipe.select!r} asks for scores, and nothing scores; choose last or best")
    last = folder / "checkpoints" / "last.ckpt"
    saver = Checkpoints(last, recipe.checkpoint_every, recipe.validate_every)
    averaging = [EMA(recipe.ema, recipe.ema_warmup)] if recipe.ema else []
    bars = [BARS[machine.progress]()] if machine.progress != "none" else []
    trainer = Trainer(
        accelerator=machine.accelerator,
        devices=machine.devices,
        num_nodes=machine.num_nodes,
        strategy=machine.strategy,
        precision=cast(Any, machine.precision),  # Lightning's own names; it tells a wrong one
        max_steps=recipe.steps,
        max_epochs=-1,
        val_check_interval=recipe.validate_every,
        check_val_every_n_epoch=None,
        limit_val_batches=recipe.val_batches or 1.0,
        num_sanity_val_steps=0,
        log_every_n_steps=machine.log_every,
        logger=False,
        callbacks=[*averaging, best, RunRecord(record, pace, machine.log_every), *callbacks, *bars, saver],
        plugins=[AtomicCheckpointIO(module.state_dict())],
        enable_checkpointing=False,
        enable_progress_bar=bool(bars),
        enable_model_summary=False,
        use_distributed_sampler=False,
        default_root_dir=folder,
        **{"profiler": pace, **machine.extra},
    )
    if machine.compile:
        module.compile_loss()
    with warnings.catch_warnings():
        for harmless in HARMLESS:
            warnings.filterwarnings("ignore", message=f".*{harmless}.*")
        trainer.fit(module, datamodule=data, ckpt_path=last if last.exists() else None, weights_only=True)
    if trainer.interrupted or trainer.global_step < recipe.steps:
        raise InterruptedError(f"training stopped at step {trainer.global_step} of {recipe.steps}; run again to resume")
    kept = keepers.get(recipe.select)
    if kept is not None and kept.weights:
        return Fitted(kept.weights, kept.step, record.seconds, kept.value if kept is best else None)
    broken = [name for name, value in module.model.named_parameters() if not torch.isfinite(value).all()]
    if broken:
        raise ValueError(
            f"training diverged: {broken[0]} is not finite after step {trainer.global_step}; lower train.lr or set "
            f"train.clip, and delete {last} to start anew"
        )
    weights = {k: v.detach().cpu().clone() for k, v in module.model.state_dict().items()}
    loss = trainer.callback_metrics.get("val/loss")
    return Fitted(weights, trainer.global_step, record.seconds, None if loss is None else float(loss))

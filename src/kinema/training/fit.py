"""Fit one module with Lightning and return its selected weights."""

from __future__ import annotations

import logging
import signal
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from lightning.pytorch import Callback, LightningDataModule, Trainer
from torch import Tensor

from kinema.signals import Interrupted, interruptible
from kinema.training.callbacks import EMA, BestWeights, Checkpoints, RunRecord, Selection
from kinema.training.checkpoint import AtomicCheckpointIO
from kinema.training.divergence import DivergedError, check_weights
from kinema.training.machine import Machine
from kinema.training.modules import StageModule
from kinema.training.pace import Pace
from kinema.training.progress import PlainProgress, StepProgress
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

BARS = {"rich": StepProgress, "tqdm": PlainProgress}


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
    selecting = [best] if recipe.select == best.keeps else []  # who keeps nothing copies no weights
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
        callbacks=[*averaging, *selecting, RunRecord(record, pace, machine.log_every), *callbacks, *bars, saver],
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
        _run(trainer, module, data, last, saver)
    kept = keepers.get(recipe.select)
    if kept is not None and kept.weights:
        return Fitted(kept.weights, kept.step, record.seconds, kept.value if kept is best else None)
    if kept is not None and trainer.is_global_zero:  # of several processes, the first alone looks, and writes
        raise ValueError(
            f"train.select={recipe.select} keeps the best of the weights, and none had a {recipe.select} (the "
            "notes say why): mend that, or choose last"
        )
    weights = {k: v.detach().cpu().clone() for k, v in module.model.state_dict().items()}
    loss = trainer.callback_metrics.get("val/loss")
    return Fitted(weights, trainer.global_step, record.seconds, None if loss is None else float(loss))


def _run(trainer: Trainer, module: StageModule, data: LightningDataModule, last: Path, saver: Checkpoints) -> None:
    """Train to the end.

    Raises Interrupted, naming the step, where a signal came first, and DivergedError at the first number that is not
    finite.
    """
    signum = signal.SIGTERM
    try:
        with interruptible():
            trainer.fit(module, datamodule=data, ckpt_path=last if last.exists() else None, weights_only=True)
        if trainer.global_step >= module.recipe.steps:
            return check_weights(module, trainer.global_step)
    except DivergedError as error:
        kept = f"; the checkpoint of step {saver.step} is kept, {last}" if saver.step else ""
        raise DivergedError(f"{error}; lower train.lr, set train.clip=1 or raise train.warmup{kept}") from None
    except SystemExit as end:
        # Lightning answers Ctrl-C, and a SIGTERM that it sees before we do, by exits that name no signal.
        if isinstance(end, Interrupted):
            signum = signal.Signals(end.signum)
        elif isinstance(end.__context__, KeyboardInterrupt):
            signum = signal.SIGINT
    where = f" at step {trainer.global_step} of {module.recipe.steps}"
    raise Interrupted(signum, where, f" from step {saver.step}" if saver.step else " from the start")

"""Describe how one stage is trained: optimiser, learning-rate schedule, averaging, budget."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated

import torch
from annotated_types import Len
from torch import nn

from kinema.options import Count, NonNegative, Number, OneOf, OpenShare, Options, Positive, Size

ORIGINS = ("start", "warmup_end")
DECAYS = ("milestones", "cosine")
SELECTIONS = ("last", "best", "fid")


@dataclass(frozen=True)
class Recipe(Options):
    """Hold the numbers of one training stage; `steps` counts optimiser steps.

    Learning rate at step k (from 0), as the published loops have it (MARDM §3-§4): warm-up lr*(k+2)/(warmup+1) that
    stops at lr*warmup/(warmup+1), then `gamma` at each milestone, counted from step 0 (`milestones_from: start`) or
    from the end of the warm-up (`warmup_end`); `decay: cosine` instead falls to a hundredth over the whole run.
    The weights that are kept are the last, those of the least validation loss (`select: best`), or those of the least
    FID on the validation split (`fid`, a generator's alone).
    """

    steps: Count
    batch_size: Count
    lr: Positive = 2e-4
    betas: Annotated[Sequence[OpenShare], Len(2, 2)] = (0.9, 0.99)
    weight_decay: NonNegative = 0.0
    warmup: Number = 0
    milestones: Sequence[Number] = ()
    milestones_from: Annotated[str, OneOf(ORIGINS)] = "start"
    gamma: NonNegative = 0.1
    decay: Annotated[str, OneOf(DECAYS)] = "milestones"
    ema: OpenShare | None = None
    ema_warmup: bool = True
    clip: Positive | None = None
    clip_each: Sequence[str] = ()
    select: Annotated[str, OneOf(SELECTIONS)] = "last"
    validate_every: Count = 1000
    checkpoint_every: Count = 500
    val_batches: Count | None = None
    window: Size = 64
    legacy_windows: bool = False

    def factor(self, step: int) -> float:
        """Return the factor on the learning rate at an optimiser step (from 0)."""
        warm = min(step + 2, self.warmup) / (self.warmup + 1) if self.warmup else 1.0
        if self.decay == "cosine":
            progress = min(1.0, step / max(1, self.steps))
            return warm * (0.01 + 0.99 * 0.5 * (1 + torch.cos(torch.tensor(torch.pi * progress)).item()))
        offset = self.warmup - 1 if self.milestones_from == "warmup_end" and self.warmup else 0
        return warm * self.gamma ** sum(step >= offset + m for m in self.milestones)

    def optimizer(self, parameters: Iterable[nn.Parameter], *, fused: bool = False) -> torch.optim.Optimizer:
        """Make AdamW over what is trainable (weight decay 0 makes it Adam); `fused`: a step is one pass over memory."""
        trainable = [p for p in parameters if p.requires_grad]
        first, second = self.betas
        return torch.optim.AdamW(
            trainable, lr=self.lr, betas=(first, second), weight_decay=self.weight_decay, fused=fused
        )

"""Stop a training whose numbers are not finite, before it saves any of them."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor, nn


class DivergedError(ValueError):
    """Say what of a training is not finite, and at which step."""


def check_loss(kind: str, loss: float | Tensor, step: int) -> None:
    """Raise DivergedError for a loss that is not finite."""
    if not math.isfinite(loss):
        raise DivergedError(f"training diverged: at step {step} the {kind} loss is {float(loss)}")


class FirstLoss:
    """Keep the first loss that is not finite where it was computed: looking at every loss would wait for its step."""

    def __init__(self) -> None:
        self.step: Tensor | None = None
        self.loss: Tensor | None = None

    def see(self, loss: Tensor, step: int) -> None:
        """Keep the loss and its step, from 1, if it is the first."""
        loss = loss.detach().float()
        if self.step is None or self.loss is None:
            self.step, self.loss = torch.zeros((), dtype=torch.int64, device=loss.device), torch.zeros_like(loss)
        first = ~loss.isfinite() & (self.step == 0)
        self.step, self.loss = torch.where(first, step, self.step), torch.where(first, loss, self.loss)

    def check(self, gather: Callable[[Tensor], Tensor]) -> None:
        """Raise DivergedError naming it, on every rank at once; `gather` returns a number of all ranks."""
        if self.step is None or self.loss is None:
            return
        found = zip(gather(self.step).reshape(-1).tolist(), gather(self.loss).reshape(-1).tolist(), strict=True)
        for step, loss in sorted((step, loss) for step, loss in found if step)[:1]:
            check_loss("training", loss, step)


def check_weights(module: nn.Module, step: int) -> None:
    """Raise DivergedError naming the first weight that is not finite."""
    for name, value in module.named_parameters():
        if not value.isfinite().all():
            raise DivergedError(f"training diverged: at step {step} {name.removeprefix('model.')} is not finite")

"""Stop a training whose numbers are not finite, before it saves any of them."""

from __future__ import annotations

from torch import Tensor, nn


class DivergedError(ValueError):
    """Say what of a training is not finite, and at which step."""


def check_loss(kind: str, loss: Tensor, step: int, *, finite: bool) -> None:
    """Raise DivergedError for a loss that is not finite, on this rank or (`finite` is false) on another."""
    if not finite:
        raise DivergedError(f"training diverged: at step {step} the {kind} loss is {float(loss)}")


def check_weights(module: nn.Module, step: int) -> None:
    """Raise DivergedError naming the first weight that is not finite."""
    for name, value in module.named_parameters():
        if not value.isfinite().all():
            raise DivergedError(f"training diverged: at step {step} {name.removeprefix('model.')} is not finite")

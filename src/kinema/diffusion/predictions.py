"""Say what a denoiser predicts: the target in training, and the clean data that a prediction implies in sampling."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from torch import Tensor

Blend = Callable[[Tensor, Tensor, Tensor, Tensor], Tensor]
"""blend(x1, noise, signal, sigma): a training target; x_t = signal x1 + sigma noise, signal = sqrt(abar_t)."""


@dataclass(frozen=True)
class Prediction:
    """Hold `target` and its inverse, `clean(x_t, output, abar_t)`: affine in the output, so guidance commutes with it.

    `amplifies` says that an error of the output reaches the clean data multiplied by sigma / signal.
    """

    target: Blend
    clean: Callable[[Tensor, Tensor, float], Tensor]
    amplifies: bool = False


def clean_from_epsilon(x: Tensor, output: Tensor, alpha_bar: float) -> Tensor:
    """Undo x = sqrt(abar) x1 + sqrt(1 - abar) epsilon."""
    return alpha_bar**-0.5 * x - (1 / alpha_bar - 1) ** 0.5 * output


def clean_from_velocity(x: Tensor, output: Tensor, alpha_bar: float) -> Tensor:
    """Turn (x, v = sqrt(abar) epsilon - sqrt(1 - abar) x1) back (Salimans & Ho 2022)."""
    return alpha_bar**0.5 * x - (1 - alpha_bar) ** 0.5 * output


PREDICTIONS = {
    "epsilon": Prediction(lambda x1, noise, signal, sigma: noise, clean_from_epsilon, amplifies=True),
    "x0": Prediction(lambda x1, noise, signal, sigma: x1, lambda x, output, alpha_bar: output),
    "velocity": Prediction(lambda x1, noise, signal, sigma: signal * noise - sigma * x1, clean_from_velocity),
}

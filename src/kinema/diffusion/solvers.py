"""Integrate dx/dt = velocity(x, t) from t = 0 to 1."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import torch
from torch import Tensor

from kinema.diffusion.guidance import Predict

Velocity = Callable[[Tensor, float], Tensor]


def euler(velocity: Velocity, x: Tensor, t: float, dt: float) -> Tensor:
    """Step with one evaluation, order 1."""
    return x + dt * velocity(x, t)


def midpoint(velocity: Velocity, x: Tensor, t: float, dt: float) -> Tensor:
    """Step with two evaluations, order 2."""
    return x + dt * velocity(x + dt / 2 * velocity(x, t), t + dt / 2)


def heun(velocity: Velocity, x: Tensor, t: float, dt: float) -> Tensor:
    """Step with two evaluations at both ends (trapezoid), order 2."""
    first = velocity(x, t)
    return x + dt / 2 * (first + velocity(x + dt * first, t + dt))


def rk4(velocity: Velocity, x: Tensor, t: float, dt: float) -> Tensor:
    """Step with four evaluations, order 4 (Kutta's 3/8 rule, the `rk4` of torchdiffeq)."""
    first = velocity(x, t)
    second = velocity(x + dt * first / 3, t + dt / 3)
    third = velocity(x + dt * (second - first / 3), t + dt * 2 / 3)
    fourth = velocity(x + dt * (first - second + third), t + dt)
    return x + dt / 8 * (first + 3 * (second + third) + fourth)


STEPS = {"euler": euler, "midpoint": midpoint, "heun": heun, "rk4": rk4}


def integrate(
    predict: Predict, x: Tensor, *, times: Sequence[float], solver: str = "euler", lands: bool = False
) -> Tensor:
    """Step from each time to the next: no row's result depends on the other rows.

    `lands`: the last step is Euler's, for a velocity that is not defined at its end.
    """

    def velocity(x: Tensor, t: float) -> Tensor:
        return predict(x, x.new_full((1,), t))

    last = len(times) - 2
    for i, (start, end) in enumerate(pairwise(times)):
        step = euler if lands and i == last else STEPS[solver]
        x = step(velocity, x, start, end - start)
    return x


def dopri5(predict: Predict, x: Tensor, *, end: float = 1.0, rtol: float = 1e-3, atol: float = 1e-6) -> Tensor:
    """Integrate up to `end` by torchdiffeq's adaptive Dormand-Prince 5(4), as published (MARDM §5).

    The step control takes the RMS over all rows, so a row's result depends on its neighbours by up to the tolerance.
    """
    from torchdiffeq import odeint

    span = torch.tensor([0.0, end], device=x.device, dtype=x.dtype)
    options = {"dtype": x.dtype} if x.device.type == "mps" else None  # its times are float64, which MPS has not
    found = odeint(
        lambda t, x: predict(x, t.reshape(1)), x, span, rtol=rtol, atol=atol, method="dopri5", options=options
    )
    return found[-1]

"""Step along a flow by the clean data: rows with a start and an end of their own (shortcut models, FRONTIER §8).

A step's end is a blend of its start and of the clean data that it aims at, and any end says which those are.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from kinema.diffusion.flow import along
from kinema.diffusion.guidance import Predict

SOLVERS = ("euler", "heun")
Times = Float[Tensor, " n"]


def landed(x: Float[Tensor, "n *d"], clean: Float[Tensor, "n *d"], start: Times, end: Times) -> Float[Tensor, "n *d"]:
    """Step from x at `start` by the velocity (clean - x) / (1 - start); at the end 1 this is the clean data."""
    return x + along((end - start) / (1 - start), x) * (clean - x)


def aimed(x: Float[Tensor, "n *d"], reached: Float[Tensor, "n *d"], start: Times, end: Times) -> Float[Tensor, "n *d"]:
    """Return the clean data by which a step from x ends at `reached`: what `landed` is undone by."""
    return x + along((1 - start) / (end - start), x) * (reached - x)


def followed(
    predict: Predict, x: Float[Tensor, "n *d"], start: Times, end: Times, *, substeps: int = 1, solver: str = "euler"
) -> Float[Tensor, "n *d"]:
    """Go from `start` to `end` in equal steps by a prediction of the clean data, Euler's or Heun's.

    The last step before 1, where a velocity has no value, is Euler's.
    """
    for k in range(substeps):
        t, then = (torch.lerp(start, end, i / substeps) for i in (k, k + 1))  # whose ends are exact
        clean = predict(x, t)
        ahead = landed(x, clean, t, then)
        if solver == "heun":
            share = along((then - t) / (1 - then).clamp(min=1e-6), x)
            both = (ahead + x + share * (predict(ahead, then) - ahead)) / 2
            ahead = torch.where(along(then, x) < 1, both, ahead)
        x = ahead
    return x

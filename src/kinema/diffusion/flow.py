"""Flow from noise to data along straight lines: the velocity loss, ODE and SDE sampling."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Annotated

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from kinema.diffusion.grids import GRIDS
from kinema.diffusion.guidance import Predict
from kinema.diffusion.projection import projected
from kinema.diffusion.solvers import STEPS, dopri5, integrate
from kinema.options import FullShare, OneOf, Positive, checked
from kinema.registry import buildable

SOLVERS = (*STEPS, "dopri5", "sde")
PREDICTIONS = ("velocity", "x1")
HOLDINGS = ("path", "projection")
TIMES = ("uniform", "stratified")
NEAREST = 1e-3
"""How near to the data a velocity is still computed of a clean estimate, in sampling."""


@buildable
class Flow(nn.Module):
    """Linear path x_t = t x1 + (1 - t) x0 from noise x0 (t = 0) to data x1 (t = 1), velocity x1 - x0 (MARDM §5, SiT).

    x0 has the deviation `source_scale`. The network predicts the velocity, or the clean data ("x1"), which is scored as
    the velocity (x1 - x_t) / max(1 - t, `clamp`) that it implies (FRONTIER §2.4). Training draws its `times` "uniform",
    or "stratified" over those of a batch, so that none has more than its share of the late ones, which count most.

    Solvers: euler, midpoint, heun, rk4 and sde take the steps of a grid (by default midpoint, 25 equal ones); dopri5,
    as published, chooses its own. The velocity of a clean estimate has no value at t = 1: there the last step is
    Euler's, which lands on the estimate.
    """

    @checked
    def __init__(
        self,
        *,
        prediction: Annotated[str, OneOf(PREDICTIONS)] = "velocity",
        source_scale: Positive = 1.0,
        clamp: FullShare = 0.05,
        times: Annotated[str, OneOf(TIMES)] = "uniform",
    ) -> None:
        super().__init__()
        self.prediction, self.source_scale, self.clamp, self.times = prediction, source_scale, clamp, times

    def resolve(
        self, solver: str | None, steps: int | str | None, grid: str = "uniform"
    ) -> tuple[str, Sequence[float]]:
        """Check a choice of solver, steps and grid, fill in the defaults and lay the times."""
        solver, steps = solver or "midpoint", 25 if steps is None else steps
        if solver not in SOLVERS:
            raise ValueError(f"solver {solver!r} is unknown to Flow; choose one of {', '.join(SOLVERS)}")
        if not isinstance(steps, int) or steps < 1:
            raise ValueError(f"a flow takes a whole number of at least 1 solver steps, got {steps!r}")
        if grid not in GRIDS:
            raise ValueError(f"grid {grid!r} is unknown; choose one of {', '.join(GRIDS)}")
        if grid != "uniform" and solver == "dopri5":
            raise ValueError(f"dopri5 chooses its own steps, so that grid {grid!r} has no effect; use grid 'uniform'")
        return solver, GRIDS[grid](steps, self.source_scale)

    def draw_times(self, shape: tuple[int, ...], generator: torch.Generator | None, device: torch.device) -> Tensor:
        """Draw training times: uniform in [0, 1), each from an interval of its own where they are stratified."""
        drawn = torch.rand(shape, generator=generator, device=device)
        if self.times == "uniform":
            return drawn
        count = drawn.numel()
        order = torch.randperm(count, generator=generator, device=device).view(shape)
        return ((order + drawn) / count).clamp(max=1 - 2**-24)

    def add_noise(self, x1: Float[Tensor, "n *d"], time: Tensor, noise: Float[Tensor, "n *d"]) -> Float[Tensor, "n *d"]:
        """Interpolate between scaled standard `noise` and data."""
        time = along(time, x1)
        return time * x1 + (1 - time) * (self.source_scale * noise)

    def progress(self, time: Tensor) -> float:
        """Return how far from noise (0) to data (1) one time is."""
        return time.item()

    def errors(
        self, predict: Predict, x1: Float[Tensor, "n *d"], time: Tensor, noise: Float[Tensor, "n *d"]
    ) -> Float[Tensor, "n *d"]:
        """Return the squared errors of the velocity, to be averaged by `loss` or over what is no padding."""
        output = predict(self.add_noise(x1, time, noise), time)
        if self.prediction == "x1":
            return ((output - x1) / (1 - along(time, x1)).clamp(min=self.clamp)).square()
        return (output - (x1 - self.source_scale * noise)).square()

    def loss(
        self, predict: Predict, x1: Float[Tensor, "n *d"], time: Tensor, noise: Float[Tensor, "n *d"]
    ) -> Float[Tensor, " n"]:
        """Return the squared error of the velocity per row, averaged over its dims."""
        return self.errors(predict, x1, time, noise).flatten(1).mean(dim=1)

    def velocity(self, predict: Predict) -> Predict:
        """Return the velocity that a prediction is, or implies."""
        if self.prediction == "velocity":
            return predict
        return lambda x, t: (predict(x, t) - x) / (1 - t).clamp(min=NEAREST)

    def sample(
        self,
        predict: Predict,
        noise: Iterator[Float[Tensor, "n *d"]],
        *,
        solver: str | None = None,
        steps: int | str | None = None,
        grid: str = "uniform",
        temperature: float = 1.0,
        clip: tuple[Tensor, Tensor] | None = None,
        known: tuple[Float[Tensor, "n *d"], Bool[Tensor, "n *d"]] | None = None,
        holding: str = "path",
        renewal: float | None = None,
        times: Sequence[float] | None = None,
    ) -> Float[Tensor, "n *d"]:
        """Sample from noise to data: standard `noise` yields the start, then ("sde") one draw per step but the last.

        `temperature` scales the SDE's noise; `clip` holds the result inside (min, max). Where the mask of `known`
        (values, mask) is True, the velocity is that which leads to its values; with `holding` "projection" steps are
        Euler's, and `projected` at every one by the share `renewal` (one draw of noise each). `times` replace the grid.
        """
        solver, laid = self.resolve(solver, steps, grid)
        times = laid if times is None else times
        if solver != "sde" and temperature != 1:
            raise ValueError(f"temperature {temperature} has no effect on the ODE solver {solver!r}; use 1.0 or 'sde'")
        velocity = self.velocity(predict)
        projects = known is not None and holding == "projection"
        velocity = velocity if known is None or projects else leading_to(*known, velocity)
        noise = (self.source_scale * draw for draw in noise)
        lands = self.prediction == "x1"
        if known is not None and projects:
            x = projected(velocity, noise, times, known, self.source_scale, renewal)
        elif solver == "sde":
            x = euler_maruyama(velocity, noise, times, temperature, self.source_scale)
        elif solver == "dopri5" and lands:
            x = integrate(velocity, dopri5(velocity, next(noise), end=1 - NEAREST), times=(1 - NEAREST, 1.0))
        elif solver == "dopri5":
            x = dopri5(velocity, next(noise))
        else:
            x = integrate(velocity, next(noise), solver=solver, times=times, lands=lands)
        return x if clip is None else x.clamp(*clip)


def along(time: Tensor, x: Tensor) -> Tensor:
    """View one time, or one for each sample, so that it is broadcast over samples like `x`."""
    return time.view((-1,) + (1,) * (x.ndim - 1))


def leading_to(values: Float[Tensor, "n *d"], mask: Bool[Tensor, "n *d"], predict: Predict) -> Predict:
    """Replace the velocity where the mask is True by (values - x) / (1 - t), which arrives at the values."""
    return lambda x, t: torch.where(mask, (values - x) / (1 - t).clamp(min=1e-3), predict(x, t))


def score(x: Tensor, velocity: Tensor, t: float, source_scale: float = 1.0) -> Tensor:
    """Derive the score of x_t from the velocity of the linear path.

    With x = t x1 + (1-t) x0 and v = E[x1 - x0 | x]: E[x0 | x] = x - t v, and the score of a variable with Gaussian
    noise of deviation s is -E[x0 | x] / ((1-t) s^2) = (t v - x) / ((1-t) s^2).
    """
    return (t * velocity - x) / ((1 - t) * source_scale**2)


def euler_maruyama(
    predict: Predict,
    noise: Iterator[Tensor],
    times: Sequence[float],
    temperature: float = 1.0,
    source_scale: float = 1.0,
) -> Tensor:
    """Integrate dx = (v + w/2 score) dt + sqrt(w) dW with w_t = (1 - t) s^2 (paper Eq. 11, where s = 1).

    Any w >= 0 has the marginals of the ODE; w = (1 - t) s^2 cancels the score's pole at t = 1 and ends without noise.
    `noise` has the deviation s. The last step is the ODE's.
    """
    x = next(noise)
    for t, end in pairwise(times):
        dt = end - t
        velocity = predict(x, x.new_full((1,), t))
        if end == times[-1]:
            return x + dt * velocity
        drift = velocity + (1 - t) * source_scale**2 / 2 * score(x, velocity, t, source_scale)
        x = x + dt * drift + temperature * ((1 - t) * dt) ** 0.5 * next(noise)
    return x

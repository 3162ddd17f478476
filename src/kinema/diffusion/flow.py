"""Flow from noise to data along straight lines: the velocity loss, ODE and SDE sampling."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from kinema.diffusion.guidance import Predict
from kinema.diffusion.solvers import STEPS, dopri5, integrate
from kinema.registry import buildable

SOLVERS = (*STEPS, "dopri5", "sde")


@buildable
class Flow(nn.Module):
    """Linear path x_t = t x1 + (1 - t) x0 from noise x0 (t = 0) to data x1 (t = 1), velocity x1 - x0 (MARDM §5, SiT).

    Solvers: euler, midpoint, heun, rk4 and sde take equal steps (by default midpoint, 25); dopri5, as published,
    chooses its own.
    """

    def resolve(self, solver: str | None, steps: int | str | None) -> tuple[str, int]:
        """Check a choice of solver and steps and fill in the defaults."""
        solver, steps = solver or "midpoint", 25 if steps is None else steps
        if solver not in SOLVERS:
            raise ValueError(f"solver {solver!r} is unknown to Flow; choose one of {', '.join(SOLVERS)}")
        if not isinstance(steps, int) or steps < 1:
            raise ValueError(f"a flow takes a whole number of at least 1 solver steps, got {steps!r}")
        return solver, steps

    def draw_times(self, shape: tuple[int, ...], generator: torch.Generator | None, device: torch.device) -> Tensor:
        """Draw training times: uniform in [0, 1)."""
        return torch.rand(shape, generator=generator, device=device)

    def add_noise(self, x1: Float[Tensor, "n *d"], time: Tensor, noise: Float[Tensor, "n *d"]) -> Float[Tensor, "n *d"]:
        """Interpolate between noise and data."""
        time = time.view((-1,) + (1,) * (x1.ndim - 1))
        return time * x1 + (1 - time) * noise

    def progress(self, time: Tensor) -> float:
        """Return how far from noise (0) to data (1) one time is."""
        return time.item()

    def errors(
        self, predict: Predict, x1: Float[Tensor, "n *d"], time: Tensor, noise: Float[Tensor, "n *d"]
    ) -> Float[Tensor, "n *d"]:
        """Return the squared errors of the velocity, to be averaged by `loss` or over what is no padding."""
        output = predict(self.add_noise(x1, time, noise), time)
        return (output - (x1 - noise)).square()

    def loss(
        self, predict: Predict, x1: Float[Tensor, "n *d"], time: Tensor, noise: Float[Tensor, "n *d"]
    ) -> Float[Tensor, " n"]:
        """Return the squared error of the velocity per row, averaged over its dims."""
        return self.errors(predict, x1, time, noise).flatten(1).mean(dim=1)

    def sample(
        self,
        predict: Predict,
        noise: Iterator[Float[Tensor, "n *d"]],
        *,
        solver: str | None = None,
        steps: int | str | None = None,
        temperature: float = 1.0,
        clip: tuple[Tensor, Tensor] | None = None,
        known: tuple[Float[Tensor, "n *d"], Bool[Tensor, "n *d"]] | None = None,
    ) -> Float[Tensor, "n *d"]:
        """Sample from noise to data: `noise` yields the start, then ("sde") one draw per step but the last.

        `temperature` scales the SDE's noise; `clip` holds the result inside (min, max). Where the mask of `known`
        (values, mask) is True, the velocity is that which leads to its values.
        """
        solver, steps = self.resolve(solver, steps)
        if solver != "sde" and temperature != 1:
            raise ValueError(f"temperature {temperature} has no effect on the ODE solver {solver!r}; use 1.0 or 'sde'")
        predict = predict if known is None else leading_to(*known, predict)
        if solver == "sde":
            x = euler_maruyama(predict, noise, steps, temperature)
        elif solver == "dopri5":
            x = dopri5(predict, next(noise))
        else:
            x = integrate(predict, next(noise), solver=solver, steps=steps)
        return x if clip is None else x.clamp(*clip)


def leading_to(values: Float[Tensor, "n *d"], mask: Bool[Tensor, "n *d"], predict: Predict) -> Predict:
    """Replace the velocity where the mask is True by (values - x) / (1 - t), which arrives at the values."""
    return lambda x, t: torch.where(mask, (values - x) / (1 - t).clamp(min=1e-3), predict(x, t))


def score(x: Tensor, velocity: Tensor, t: float) -> Tensor:
    """Derive the score of x_t from the velocity of the linear path.

    With x = t x1 + (1-t) x0 and v = E[x1 - x0 | x]: E[x0 | x] = x - t v, and the score of a Gaussian-noised variable is
    -E[x0 | x] / (1-t) = (t v - x) / (1-t).
    """
    return (t * velocity - x) / (1 - t)


def euler_maruyama(predict: Predict, noise: Iterator[Tensor], steps: int, temperature: float = 1.0) -> Tensor:
    """Integrate dx = (v + w/2 score) dt + sqrt(w) dW with w_t = 1 - t (paper Eq. 11).

    Any w >= 0 has the marginals of the ODE; w = 1 - t cancels the score's pole at t = 1 and ends without noise. The
    last step is the ODE's.
    """
    x = next(noise)
    dt = 1 / steps
    for i in range(steps):
        t = i * dt
        velocity = predict(x, x.new_full((1,), t))
        if i == steps - 1:
            return x + dt * velocity
        drift = velocity + (1 - t) / 2 * score(x, velocity, t)
        x = x + dt * drift + temperature * ((1 - t) * dt) ** 0.5 * next(noise)
    return x

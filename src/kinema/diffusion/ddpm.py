"""Diffuse over discrete steps: the noise and the error of training, and sampling by a choice of solvers."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import Annotated

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from kinema.diffusion.denoising import ODE_SOLVERS, ancestral
from kinema.diffusion.guidance import Predict
from kinema.diffusion.predictions import PREDICTIONS
from kinema.diffusion.schedules import BETAS, Schedule, make_schedule
from kinema.options import OneOf, Size, checked
from kinema.registry import buildable

SOLVERS = ("ancestral", *ODE_SOLVERS)
MOST_AMPLIFICATION = 20.0
"""The sigma / signal from which an ODE solver starts with a model of epsilon: MLD's is 14, a cosine's end 1015."""


@buildable
class DDPM(nn.Module):
    """Denoising diffusion with a fixed small (posterior) variance (MARDM §5; time runs from T-1, noise, to 0).

    Predictions: "epsilon", "x0", "velocity". Solvers: "ancestral" (default), and without noise "ddim", "heun" and
    "dpmpp_2m", over all steps or fewer (see `spaced_timesteps`).
    """

    signal: Tensor
    noise: Tensor

    @checked
    def __init__(
        self,
        steps: Size = 50,
        schedule: Annotated[str, OneOf(BETAS)] = "cosine",
        prediction: Annotated[str, OneOf(PREDICTIONS)] = "epsilon",
    ) -> None:
        super().__init__()
        self.schedule = make_schedule(schedule, steps)
        self.prediction = prediction
        alphas_cumprod = self.schedule.alphas_cumprod
        self.register_buffer("signal", alphas_cumprod.sqrt().float(), persistent=False)
        self.register_buffer("noise", (1 - alphas_cumprod).sqrt().float(), persistent=False)

    def draw_times(self, shape: tuple[int, ...], generator: torch.Generator | None, device: torch.device) -> Tensor:
        """Draw training times: uniform over the steps."""
        return torch.randint(len(self.schedule.betas), shape, generator=generator, device=device)

    def progress(self, time: Tensor) -> float:
        """Return how far from noise (0) to data (1) one time is."""
        return 1 - (time.item() + 1) / len(self.schedule.betas)

    def add_noise(self, x1: Float[Tensor, "n *d"], time: Tensor, noise: Float[Tensor, "n *d"]) -> Float[Tensor, "n *d"]:
        """Noise clean data: sqrt(abar_t) x1 + sqrt(1 - abar_t) noise."""
        signal, sigma = self._levels(x1, time)
        return signal * x1 + sigma * noise

    def errors(
        self, predict: Predict, x1: Float[Tensor, "n *d"], time: Tensor, noise: Float[Tensor, "n *d"]
    ) -> Float[Tensor, "n *d"]:
        """Return the squared errors of the prediction, to be averaged by `loss` or over what is no padding."""
        output = predict(self.add_noise(x1, time, noise), time)
        return (output - PREDICTIONS[self.prediction].target(x1, noise, *self._levels(x1, time))).square()

    def loss(
        self, predict: Predict, x1: Float[Tensor, "n *d"], time: Tensor, noise: Float[Tensor, "n *d"]
    ) -> Float[Tensor, " n"]:
        """Return the squared error of the prediction per row, averaged over its dims."""
        return self.errors(predict, x1, time, noise).flatten(1).mean(dim=1)

    def resolve(self, solver: str | None, steps: int | str | None, grid: str = "uniform") -> tuple[str, Schedule]:
        """Check a choice of solver and steps, fill in the defaults and respace the schedule.

        A model of epsilon multiplies its error by sigma / signal, and an ODE solver adds no noise to forget it in: a
        count of steps is spread over the timesteps where this is at most `MOST_AMPLIFICATION`, any other choice that
        goes beyond is taken with a warning.
        """
        solver = solver or "ancestral"
        if solver not in SOLVERS:
            raise ValueError(f"solver {solver!r} is unknown to DDPM; choose one of {', '.join(SOLVERS)}")
        if grid != "uniform":
            raise ValueError(f"grid {grid!r} is a flow's; DDPM takes the steps of its schedule: use grid 'uniform'")
        exposed = solver in ODE_SOLVERS and PREDICTIONS[self.prediction].amplifies
        schedule = self.schedule
        if exposed and str(steps).isdecimal():
            schedule = schedule.below(MOST_AMPLIFICATION)
        schedule = schedule if steps is None else schedule.respace(steps)
        if exposed and schedule.amplification[-1] > MOST_AMPLIFICATION:
            _warn(solver, schedule)
        return solver, schedule

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
    ) -> Float[Tensor, "n *d"]:
        """Sample from noise to data: `noise` yields the start, then (ancestral) one draw per step but the last.

        `temperature` scales the step noise; `clip` holds the estimate of the clean data inside (min, max) at every
        step, which an undertrained epsilon model needs: the first step of the cosine schedule multiplies its error
        by 32. `known` (values, mask) replaces the estimate where the mask is True (MDM §5), whatever `holding` and
        `renewal` say.
        """
        solver, schedule = self.resolve(solver, steps, grid)
        if solver != "ancestral" and temperature != 1:
            raise ValueError(f"temperature {temperature} has no effect on {solver!r}; use 1.0 or solver 'ancestral'")

        def clean(x: Tensor, k: int) -> Tensor:
            output = predict(x, x.new_full((1,), float(schedule.timesteps[k])))
            x0 = PREDICTIONS[self.prediction].clean(x, output, schedule.alphas_cumprod[k].item())
            x0 = x0 if clip is None else x0.clamp(*clip)
            return x0 if known is None else torch.where(known[1], known[0], x0)

        if solver == "ancestral":
            return ancestral(schedule, clean, noise, temperature)
        return ODE_SOLVERS[solver](schedule, clean, next(noise))

    def _levels(self, x: Tensor, time: Tensor) -> tuple[Tensor, Tensor]:
        shape = (-1,) + (1,) * (x.ndim - 1)
        return self.signal[time].view(shape), self.noise[time].view(shape)


def _warn(solver: str, schedule: Schedule) -> None:
    warnings.warn(
        f"{solver!r} starts at timestep {schedule.timesteps[-1]}, which multiplies the error of epsilon by "
        f"{schedule.amplification[-1]:.0f}, and adds no noise to forget it in: samples may be far off; give a count of "
        "steps, which leaves such timesteps out, or solver 'ancestral'",
        stacklevel=4,
    )

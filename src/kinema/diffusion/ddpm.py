"""Diffuse over discrete steps: the training loss and the ancestral and DDIM samplers."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from jaxtyping import Float
from torch import Tensor, nn

from kinema.diffusion.guidance import Predict
from kinema.diffusion.schedules import Schedule, make_schedule

SOLVERS = ("ancestral", "ddim")
PREDICTIONS = ("epsilon", "x0")


class DDPM(nn.Module):
    """Denoising diffusion with a fixed small (posterior) variance (MARDM §5; time runs from T-1, noise, to 0).

    Solvers: "ancestral" (default) and "ddim" (without noise), over all steps or fewer (see `spaced_timesteps`).
    """

    signal: Float[Tensor, " t"]
    noise: Float[Tensor, " t"]

    def __init__(
        self,
        steps: int = 50,
        schedule: str = "cosine",
        prediction: str = "epsilon",
    ) -> None:
        super().__init__()
        if prediction not in PREDICTIONS:
            raise ValueError(f"prediction {prediction!r} is unknown; choose one of {', '.join(PREDICTIONS)}")
        self.schedule = make_schedule(schedule, steps)
        self.prediction = prediction
        alphas_cumprod = self.schedule.alphas_cumprod
        self.register_buffer("signal", alphas_cumprod.sqrt().float(), persistent=False)
        self.register_buffer("noise", (1 - alphas_cumprod).sqrt().float(), persistent=False)

    def draw_times(self, shape: tuple[int, ...], generator: torch.Generator | None, device: torch.device) -> Tensor:
        """Draw training times: uniform over the steps."""
        return torch.randint(len(self.schedule.betas), shape, generator=generator, device=device)

    def add_noise(self, x1: Float[Tensor, "n *d"], time: Tensor, noise: Float[Tensor, "n *d"]) -> Float[Tensor, "n *d"]:
        """Noise clean data: sqrt(abar_t) x1 + sqrt(1 - abar_t) noise."""
        shape = (-1,) + (1,) * (x1.ndim - 1)
        return self.signal[time].view(shape) * x1 + self.noise[time].view(shape) * noise

    def loss(
        self, predict: Predict, x1: Float[Tensor, "n *d"], time: Tensor, noise: Float[Tensor, "n *d"]
    ) -> Float[Tensor, " n"]:
        """Return the squared error of the prediction per row, averaged over its dims."""
        output = predict(self.add_noise(x1, time, noise), time)
        target = noise if self.prediction == "epsilon" else x1
        return (output - target).square().flatten(1).mean(dim=1)

    def output_for(self, x1: Float[Tensor, "n *d"], x: Float[Tensor, "n *d"], time: Tensor) -> Float[Tensor, "n *d"]:
        """Return the prediction at `x` that stands for clean data `x1`."""
        if self.prediction == "x0":
            return x1
        time = time.long().view((-1,) + (1,) * (x.ndim - 1))
        return (x - self.signal[time] * x1) / self.noise[time]

    def resolve(self, solver: str | None, steps: int | str | None) -> tuple[str, Schedule]:
        """Check a choice of solver and steps, fill in the defaults and respace the schedule."""
        solver = solver or "ancestral"
        if solver not in SOLVERS:
            raise ValueError(f"solver {solver!r} is unknown to DDPM; choose one of {', '.join(SOLVERS)}")
        return solver, self.schedule if steps is None else self.schedule.respace(steps)

    def sample(
        self,
        predict: Predict,
        noise: Iterator[Float[Tensor, "n *d"]],
        *,
        solver: str | None = None,
        steps: int | str | None = None,
        temperature: float = 1.0,
        clip: tuple[Tensor, Tensor] | None = None,
    ) -> Float[Tensor, "n *d"]:
        """Sample from noise to data: `noise` yields the start, then (ancestral) one draw per step but the last.

        `temperature` scales the step noise; `clip` holds the estimate of the clean data inside (min, max) at every
        step, which an undertrained epsilon model needs: the first step of the cosine schedule multiplies its error
        by 32.
        """
        solver, schedule = self.resolve(solver, steps)
        if solver == "ddim" and temperature != 1:
            raise ValueError(f"temperature {temperature} has no effect on 'ddim'; use 1.0 or solver 'ancestral'")
        x = next(noise)
        for k in reversed(range(len(schedule.betas))):
            x0 = self._clean(predict, x, schedule, k)
            if clip is not None:
                x0 = x0.clamp(*clip)
            x = ddim_step(schedule, k, x, x0) if solver == "ddim" else posterior_mean(schedule, k, x, x0)
            if solver == "ancestral" and k > 0:
                x = x + temperature * schedule.posterior_variance[k].sqrt().item() * next(noise)
        return x

    def _clean(self, predict: Predict, x: Tensor, schedule: Schedule, k: int) -> Tensor:
        output = predict(x, x.new_full((1,), float(schedule.timesteps[k])))
        if self.prediction == "x0":
            return output
        alpha_bar = schedule.alphas_cumprod[k].item()
        return alpha_bar**-0.5 * x - (1 / alpha_bar - 1) ** 0.5 * output


def posterior_mean(schedule: Schedule, k: int, x: Tensor, x0: Tensor) -> Tensor:
    """Return the mean of q(x_{k-1} | x_k, x0)."""
    return schedule.posterior_mean_coef1[k].item() * x0 + schedule.posterior_mean_coef2[k].item() * x


def ddim_step(schedule: Schedule, k: int, x: Tensor, x0: Tensor) -> Tensor:
    """Step without noise (eta 0) along the noise direction that (x, x0) imply."""
    alpha_bar, before = schedule.alphas_cumprod[k].item(), schedule.alphas_cumprod_prev[k].item()
    epsilon = (x - alpha_bar**0.5 * x0) / (1 - alpha_bar) ** 0.5
    return before**0.5 * x0 + (1 - before) ** 0.5 * epsilon

"""Follow an error of a denoiser's output: into the clean estimate, into one reverse step, and into the sample.

The formulas are derived from the ancestral sampler, x_{t-1} = c1_t x0(x_t, output) + c2_t x_t + noise, in which x0 is
affine in both. They are our reading of MARDM's Eq. 4, 5 and 23, whose text the specification does not hold: of epsilon,
an error d makes sigma / signal * d in x0, beta / (sqrt(alpha) sigma) * d in x_{t-1}, and, while later predictions stay
what they are, beta / (sqrt(abar) sigma) * d in the sample.
"""

from __future__ import annotations

from collections.abc import Iterator

import torch
from jaxtyping import Float
from torch import Tensor

from kinema.diffusion.ddpm import DDPM
from kinema.diffusion.guidance import Predict
from kinema.diffusion.predictions import PREDICTIONS
from kinema.diffusion.schedules import Schedule


def clean_slopes(process: DDPM, schedule: Schedule) -> tuple[Float[Tensor, " t"], Float[Tensor, " t"]]:
    """Return the derivatives of the clean estimate by x_t and by the output, at every step."""
    clean = PREDICTIONS[process.prediction].clean
    one, zero = torch.ones((), dtype=torch.float64), torch.zeros((), dtype=torch.float64)
    levels = schedule.alphas_cumprod.tolist()
    by_x = torch.stack([torch.as_tensor(clean(one, zero, level), dtype=torch.float64) for level in levels])
    by_output = torch.stack([torch.as_tensor(clean(zero, one, level), dtype=torch.float64) for level in levels])
    return by_x, by_output


def in_clean(process: DDPM) -> Float[Tensor, " t"]:
    """Return what an error of the output is multiplied by in the clean estimate (our reading of MARDM Eq. 5)."""
    return clean_slopes(process, process.schedule)[1].abs()


def in_step(process: DDPM) -> Float[Tensor, " t"]:
    """Return what it is multiplied by in the mean of x_{t-1} (our reading of MARDM Eq. 4)."""
    return process.schedule.posterior_mean_coef1 * in_clean(process)


def in_sample(process: DDPM, spread: float | None = None) -> Float[Tensor, " t"]:
    """Return what an error at one step is multiplied by in the sample (our reading of MARDM Eq. 23).

    Later predictions stay what they were; with `spread` they answer as those of the best model of Gaussian data of that
    deviation do: d E[x0 | x_t] / d x_t = signal spread^2 / (abar spread^2 + 1 - abar).
    """
    schedule = process.schedule
    abar = schedule.alphas_cumprod
    answer = clean_slopes(process, schedule)[0]
    if spread is not None:
        answer = abar.sqrt() * spread**2 / (abar * spread**2 + 1 - abar)
    carried = schedule.posterior_mean_coef1 * answer + schedule.posterior_mean_coef2
    later = torch.cat((carried.new_ones(1), carried.cumprod(0)[:-1]))
    return in_step(process) * later


def moved(
    process: DDPM, predict: Predict, noise: Iterator[Tensor], at: int, error: Float[Tensor, "n *d"]
) -> Float[Tensor, "n *d"]:
    """Sample by the ancestral sampler with `error` added to the output at timestep `at`.

    `noise` yields the start and a draw for each step but the last: the same as of the samples it is compared with.
    """

    def wrong(x: Tensor, time: Tensor) -> Tensor:
        output = predict(x, time)
        return output + error if int(time) == at else output

    return process.sample(wrong, noise, solver="ancestral")


def step_errors(
    process: DDPM, predict: Predict, x1: Float[Tensor, "n *d"], at: int, noise: Float[Tensor, "n *d"]
) -> tuple[Float[Tensor, "n *d"], Float[Tensor, "n *d"]]:
    """Return the denoiser's errors on noised data at one timestep: of its output, and of the clean estimate."""
    time = torch.full((len(x1),), at, device=x1.device)
    x = process.add_noise(x1, time, noise)
    output = predict(x, time[:1])
    kind, abar = PREDICTIONS[process.prediction], process.schedule.alphas_cumprod[at]
    target = kind.target(x1, noise, process.signal[at], process.noise[at])
    return output - target, kind.clean(x, output, abar.item()) - x1

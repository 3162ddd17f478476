"""Walk a schedule from noise to data: the ancestral sampler, and solvers of the ODE with the same marginals.

`clean(x, k)` estimates the data from x at step k of the schedule; steps run from the last, noisiest one to 0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from jaxtyping import Float
from torch import Tensor

from kinema.diffusion.schedules import Schedule

Clean = Callable[[Tensor, int], Tensor]


def posterior_mean(schedule: Schedule, k: int, x: Tensor, x0: Tensor) -> Tensor:
    """Return the mean of q(x_{k-1} | x_k, x0)."""
    return schedule.posterior_mean_coef1[k].item() * x0 + schedule.posterior_mean_coef2[k].item() * x


def ddim_step(schedule: Schedule, k: int, x: Tensor, x0: Tensor) -> Tensor:
    """Step without noise (eta 0) along the noise direction that (x, x0) imply."""
    alpha_bar, before = schedule.alphas_cumprod[k].item(), schedule.alphas_cumprod_prev[k].item()
    epsilon = (x - alpha_bar**0.5 * x0) / (1 - alpha_bar) ** 0.5
    return before**0.5 * x0 + (1 - before) ** 0.5 * epsilon


def ancestral(
    schedule: Schedule, clean: Clean, noise: Iterator[Float[Tensor, "n *d"]], temperature: float = 1.0
) -> Float[Tensor, "n *d"]:
    """Sample the chain of posteriors: one draw to start, one per step but the last; order 1 in distribution."""
    x = next(noise)
    for k in reversed(range(len(schedule.betas))):
        x = posterior_mean(schedule, k, x, clean(x, k))
        if k > 0:
            x = x + temperature * schedule.posterior_variance[k].sqrt().item() * next(noise)
    return x


def ddim(schedule: Schedule, clean: Clean, x: Float[Tensor, "n *d"]) -> Float[Tensor, "n *d"]:
    """Take DDIM steps, which are the ODE's Euler steps in x / sqrt(abar) over sigma / signal: order 1."""
    for k in reversed(range(len(schedule.betas))):
        x = ddim_step(schedule, k, x, clean(x, k))
    return x


def heun(schedule: Schedule, clean: Clean, x: Float[Tensor, "n *d"]) -> Float[Tensor, "n *d"]:
    """Average the clean data of both ends of a DDIM step: order 2 by two evaluations, but for the last step's one."""
    for k in reversed(range(len(schedule.betas))):
        x0 = clean(x, k)
        if k > 0:
            x0 = (x0 + clean(ddim_step(schedule, k, x, x0), k - 1)) / 2
        x = ddim_step(schedule, k, x, x0)
    return x


def dpmpp_2m(schedule: Schedule, clean: Clean, x: Float[Tensor, "n *d"]) -> Float[Tensor, "n *d"]:
    """Take DPM-Solver++ 2M steps: DDIM's with the clean data extrapolated from the last two, order 2 by one evaluation.

    Lu et al. 2022, Algorithm 2. The first step and the last, whose h is infinite, are of order 1.
    """
    h = (schedule.alphas_cumprod_prev.logit() - schedule.alphas_cumprod.logit()) / 2
    last = None
    for k in reversed(range(len(schedule.betas))):
        x0 = clean(x, k)
        ahead = x0 if last is None or k == 0 else x0 + (h[k] / h[k + 1] / 2).item() * (x0 - last)
        x, last = ddim_step(schedule, k, x, ahead), x0
    return x


ODE_SOLVERS = {"ddim": ddim, "heun": heun, "dpmpp_2m": dpmpp_2m}

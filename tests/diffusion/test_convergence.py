"""Measure the order at which every solver converges on Gaussian data, whose score and flow map are known."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from kinema.diffusion.denoising import ODE_SOLVERS, ancestral
from kinema.diffusion.flow import Flow
from kinema.diffusion.schedules import Schedule

MEAN, STD = 0.7, 0.3
START, END = 1e-4, 0.999
"""The abar that sampling starts from and ends at; clean data would be infinitely far on the solvers' own axis."""


def schedule(steps: int) -> Schedule:
    """Make a schedule of steps of equal size in log(signal / sigma)."""
    end, start = torch.tensor([END, START], dtype=torch.float64).logit()
    levels = torch.linspace(end, start, steps + 1, dtype=torch.float64)
    alphas_cumprod = levels.sigmoid()
    return Schedule(1 - alphas_cumprod[1:] / alphas_cumprod[:-1], torch.arange(steps), alphas_cumprod[0].item())


def spread(alpha_bar: Tensor) -> Tensor:
    """Give the deviation of x_t."""
    return (alpha_bar * STD**2 + 1 - alpha_bar).sqrt()


def denoiser(levels: Schedule):
    """Give E[x0 | x_k]."""

    def clean(x: Tensor, k: int) -> Tensor:
        alpha_bar = levels.alphas_cumprod[k]
        return MEAN + alpha_bar.sqrt() * STD**2 / spread(alpha_bar) ** 2 * (x - alpha_bar.sqrt() * MEAN)

    return clean


def flow_map(levels: Schedule, x: Tensor) -> Tensor:
    """Carry x from the start to the end along the exact ODE: its place in units of the deviation stays."""
    start, end = levels.alphas_cumprod[-1], levels.alphas_cumprod_prev[0]
    return end.sqrt() * MEAN + spread(end) * (x - start.sqrt() * MEAN) / spread(start)


def order(errors: list[float]) -> float:
    """Estimate the order from the errors of n and 2n steps."""
    return torch.log2(torch.tensor(errors[0] / errors[1])).item()


@pytest.mark.parametrize(("solver", "expected"), [("ddim", 1), ("heun", 2), ("dpmpp_2m", 2)])
def test_ode_solvers_over_a_schedule(solver, expected):
    x = torch.linspace(-2, 2, 9).double()
    errors = []
    for steps in (160, 320):
        levels = schedule(steps)
        errors.append((ODE_SOLVERS[solver](levels, denoiser(levels), x) - flow_map(levels, x)).abs().max().item())
    assert order(errors) == pytest.approx(expected, abs=0.15)
    assert errors[1] < 10.0 ** (-1 - expected)


def moments(sample, draws: int) -> tuple[float, float]:
    """Compute the exact mean and deviation of what a sampler that is affine in its `draws` normal draws returns.

    Row i gets draw i alone, and the row behind them none.
    """
    result = sample(iter(torch.eye(draws + 1, draws).double().T[:, :, None]))[:, 0]
    return result[-1].item(), (result[:-1] - result[-1]).square().sum().sqrt().item()


def test_ancestral_sampling_in_distribution():
    errors = []
    for steps in (160, 320):
        levels = schedule(steps)
        # The draws: the start, and one per step but the last, which ends at END without noise of its own.
        end = levels.alphas_cumprod_prev[0]
        mean, std = moments(lambda noise, levels=levels: ancestral(levels, denoiser(levels), noise), steps)
        errors.append(abs(std**2 + levels.posterior_variance[0].item() - spread(end).item() ** 2))
        assert mean == pytest.approx(end.sqrt().item() * MEAN, abs=1e-2)
    assert order(errors) == pytest.approx(1, abs=0.15)


def velocity(x: Tensor, t: Tensor) -> Tensor:
    """Give E[x1 - x0 | x_t] of the flow."""
    variance = t**2 * STD**2 + (1 - t) ** 2
    return MEAN + (t * STD**2 - (1 - t)) / variance * (x - t * MEAN)


def test_sde_in_distribution():
    errors = []
    for steps in (160, 320):
        sampled = moments(lambda noise, n=steps: Flow().sample(velocity, noise, solver="sde", steps=n), steps)
        assert sampled[0] == pytest.approx(MEAN, abs=1e-2)
        errors.append(abs(sampled[1] - STD))
    assert order(errors) == pytest.approx(1, abs=0.15)

"""Test the flow on Gaussian data, whose velocity and flow map have closed forms."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from kinema.diffusion.flow import Flow, score

MEAN, STD = 0.7, 0.3


def velocity(x: Tensor, t: Tensor) -> Tensor:
    """Give E[x1 - x0 | x_t] for data N(MEAN, STD^2); its flow maps x0 to MEAN + STD x0."""
    variance = t**2 * STD**2 + (1 - t) ** 2
    return MEAN + (t * STD**2 - (1 - t)) / variance * (x - t * MEAN)


def noises(*shape: int, seed: int = 0):
    generator = torch.Generator().manual_seed(seed)
    while True:
        yield torch.randn(shape, generator=generator, dtype=torch.float64)


@pytest.mark.parametrize(("solver", "order"), [("euler", 1), ("midpoint", 2), ("heun", 2), ("rk4", 4)])
def test_solvers_converge_at_their_order(solver, order):
    start = next(noises(50, 1))
    errors = [
        (Flow().sample(velocity, iter([start]), solver=solver, steps=steps) - (MEAN + STD * start)).abs().max()
        for steps in (32, 64)
    ]
    # At least: on this symmetric problem the midpoint rule gains an order.
    assert torch.log2(errors[0] / errors[1]).item() > order - 0.3


def test_dopri5_stays_within_its_tolerance():
    start = next(noises(50, 1))
    result = Flow().sample(velocity, iter([start]), solver="dopri5")
    torch.testing.assert_close(result, MEAN + STD * start, rtol=0, atol=2e-3)


def test_sde_has_the_data_distribution():
    samples = Flow().sample(velocity, noises(20000, 1), solver="sde", steps=200)
    assert samples.mean().item() == pytest.approx(MEAN, abs=0.01)
    assert samples.std().item() == pytest.approx(STD, abs=0.01)


@pytest.mark.parametrize("t", [0.0, 0.3, 0.9])
def test_score_follows_from_the_velocity(t):
    """Compare with the score of the marginal N(t MEAN, t^2 STD^2 + (1-t)^2)."""
    x = torch.linspace(-2, 2, 9, dtype=torch.float64)
    exact = -(x - t * MEAN) / (t**2 * STD**2 + (1 - t) ** 2)
    torch.testing.assert_close(score(x, velocity(x, torch.tensor(t, dtype=torch.float64)), t), exact)


@pytest.mark.parametrize("solver", ["euler", "midpoint", "heun", "rk4"])
def test_fixed_steps_do_not_mix_rows(solver):
    start = next(noises(8, 2))
    together = Flow().sample(velocity, iter([start]), solver=solver, steps=5)
    alone = Flow().sample(velocity, iter([start[3:4]]), solver=solver, steps=5)
    assert torch.equal(together[3:4], alone)


def test_sde_takes_one_noise_per_step_but_the_last():
    source = noises(2, 1)
    Flow().sample(velocity, source, solver="sde", steps=6)
    expected = noises(2, 1)
    for _ in range(6):
        next(expected)
    assert torch.equal(next(source), next(expected))


def test_loss_is_the_velocity_error_per_row():
    x1, noise, t = torch.randn(4, 3), torch.randn(4, 3), torch.rand(4)
    assert not Flow().loss(lambda x, t: x1 - noise, x1, t, noise).any()
    seen = []
    Flow().loss(lambda x, t: seen.append(x) or x, x1, torch.tensor([0.0, 1.0, 0.0, 1.0]), noise)
    assert torch.equal(seen[0][0], noise[0])
    assert torch.equal(seen[0][1], x1[1])


def test_clip_holds_the_result():
    limits = (torch.tensor(0.5), torch.tensor(0.75))
    result = Flow().sample(velocity, noises(50, 1), clip=limits)
    assert result.min() >= 0.5
    assert result.max() <= 0.75


def test_bad_choices_are_named():
    with pytest.raises(ValueError, match="solver 'ddim' is unknown to Flow; choose one of euler, midpoint"):
        Flow().sample(velocity, noises(1, 1), solver="ddim")
    with pytest.raises(ValueError, match="at least 1 solver steps, got 0"):
        Flow().sample(velocity, noises(1, 1), steps=0)
    with pytest.raises(ValueError, match=r"temperature 0\.5 has no effect on the ODE solver 'midpoint'"):
        Flow().sample(velocity, noises(1, 1), temperature=0.5)

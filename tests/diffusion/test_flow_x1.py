"""Test the flow that predicts clean data, and noise of any scale, on Gaussian data."""

from __future__ import annotations

from itertools import pairwise, product

import pytest
import torch
from torch import Tensor

from kinema.diffusion.flow import Flow
from kinema.diffusion.grids import GRIDS, LATEST

MEAN, STD = 0.7, 0.3
SCALES = (1.0, 5.0)


def clean(scale: float):
    """Return E[x1 | x_t] for data N(MEAN, STD^2) and noise of deviation `scale`."""

    def predict(x: Tensor, t: Tensor) -> Tensor:
        variance = t**2 * STD**2 + ((1 - t) * scale) ** 2
        return MEAN + t * STD**2 / variance * (x - t * MEAN)

    return predict


def velocity(scale: float):
    """Return E[x1 - x0 | x_t] of the same data and noise."""

    def predict(x: Tensor, t: Tensor) -> Tensor:
        variance = t**2 * STD**2 + ((1 - t) * scale) ** 2
        return MEAN + (t * STD**2 - (1 - t) * scale**2) / variance * (x - t * MEAN)

    return predict


def noises(*shape: int, seed: int = 0):
    generator = torch.Generator().manual_seed(seed)
    while True:
        yield torch.randn(shape, generator=generator, dtype=torch.float64)


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize(
    ("solver", "grid"), [*product(("euler", "midpoint", "heun", "rk4"), GRIDS), ("dopri5", "uniform")]
)
def test_predictions_of_both_kinds_sample_the_same(scale, solver, grid):
    """Compare with the flow map in closed form: x0 = scale * e goes to MEAN + STD * e."""
    options = {"solver": solver, "steps": 400, "grid": grid}
    start = next(noises(50, 1))
    of_clean = Flow(prediction="x1", source_scale=scale).sample(clean(scale), iter([start]), **options)
    of_velocity = Flow(source_scale=scale).sample(velocity(scale), iter([start]), **options)
    # A last step of Euler's leaves an error of its own length, times what is not yet decided there.
    tolerance = 2e-2
    torch.testing.assert_close(of_clean, MEAN + STD * start, rtol=0, atol=tolerance)
    torch.testing.assert_close(of_velocity, MEAN + STD * start, rtol=0, atol=tolerance)


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("prediction", ["velocity", "x1"])
def test_sde_has_the_data_distribution(scale, prediction):
    predict = (clean if prediction == "x1" else velocity)(scale)
    flow = Flow(prediction=prediction, source_scale=scale)
    samples = flow.sample(predict, noises(20000, 1), solver="sde", steps=200)
    assert samples.mean().item() == pytest.approx(MEAN, abs=0.01)
    assert samples.std().item() == pytest.approx(STD, abs=0.01)


def test_errors_of_a_clean_estimate_are_those_of_its_velocity():
    flow = Flow(prediction="x1", source_scale=5.0, clamp=0.05)
    x1, noise, estimate = (next(noises(6, 3, seed=seed)) for seed in range(3))
    t = torch.tensor([0.0, 0.3, 0.9, 0.94, 0.96, 1.0], dtype=torch.float64)
    x = flow.add_noise(x1, t, noise)
    torch.testing.assert_close(x, t[:, None] * x1 + (1 - t)[:, None] * 5 * noise)
    ways = (1 - t).clamp(min=0.05)[:, None]
    expected = ((estimate - x) / ways - (x1 - x) / ways).square()
    torch.testing.assert_close(flow.errors(lambda x, t: estimate, x1, t, noise), expected)
    # Before the clamp, this is the error of the velocity against the path's own.
    torch.testing.assert_close(expected[:4], (((estimate - x) / ways) - (x1 - 5 * noise))[:4].square())


def test_velocity_errors_know_the_scale_of_the_noise():
    x1, noise = next(noises(6, 3)), next(noises(6, 3, seed=1))
    t = torch.rand(6, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    assert not Flow(source_scale=5.0).errors(lambda x, t: x1 - 5 * noise, x1, t, noise).any()


@pytest.mark.parametrize("solver", ["euler", "midpoint", "heun", "rk4"])
def test_the_last_step_lands_on_the_clean_estimate(solver):
    flow = Flow(prediction="x1", source_scale=5.0)
    result = flow.sample(lambda x, t: torch.full_like(x, 0.25), noises(4, 2), solver=solver, steps=3)
    torch.testing.assert_close(result, torch.full_like(result, 0.25))


def test_known_values_are_landed_on():
    values, mask = next(noises(8, 2, seed=3)), torch.arange(16).view(8, 2) % 3 == 0
    flow = Flow(prediction="x1", source_scale=5.0)
    result = flow.sample(clean(5.0), noises(8, 2), solver="heun", steps=8, known=(values, mask))
    torch.testing.assert_close(result[mask], values[mask])


@pytest.mark.parametrize("name", GRIDS)
@pytest.mark.parametrize("steps", [1, 2, 3, 50])
def test_grids_rise_from_noise_to_data(name, steps):
    times = GRIDS[name](steps, 5.0)
    assert len(times) == steps + 1
    assert (times[0], times[-1]) == (0, 1)
    assert all(a < b for a, b in pairwise(times))


def test_emergence_follows_the_scale_of_the_noise():
    """Check that signal over noise rises by one ratio, whatever the scale of the noise."""
    for scale in SCALES:
        inner = torch.tensor(GRIDS["emergence"](9, scale)[1:-1], dtype=torch.float64)
        ratios = inner / (1 - inner) / scale
        torch.testing.assert_close(ratios[1:] / ratios[:-1], (ratios[1] / ratios[0]).expand(7))
        assert ratios[-1].item() == pytest.approx(LATEST)


def test_bad_choices_are_named():
    with pytest.raises(ValueError, match="grid 'log' is unknown; choose one of uniform, emergence"):
        Flow().sample(velocity(1), noises(1, 1), grid="log")
    with pytest.raises(ValueError, match="dopri5 chooses its own steps"):
        Flow().sample(velocity(1), noises(1, 1), grid="emergence", solver="dopri5")
    with pytest.raises(ValueError, match="prediction"):
        Flow(prediction="x0")
    with pytest.raises(ValueError, match="source_scale"):
        Flow(source_scale=0.0)


def test_stratified_times_are_uniform_and_spread_over_the_batch():
    flow = Flow(times="stratified")
    times = flow.draw_times((8, 4), torch.Generator().manual_seed(0), torch.device("cpu"))
    assert times.shape == (8, 4)
    assert (times.flatten().sort().values * 32).floor().tolist() == list(range(32))
    assert times.flatten().tolist() != times.flatten().sort().values.tolist()
    again = flow.draw_times((8, 4), torch.Generator().manual_seed(0), torch.device("cpu"))
    assert torch.equal(times, again)

"""Test steps by the clean data, and grids that halve, with a Gaussian's teacher in closed form."""

from __future__ import annotations

from itertools import pairwise

import pytest
import torch
from torch import Tensor

from kinema.diffusion.grids import GRIDS, emergence, nested
from kinema.diffusion.shortcut import SOLVERS, aimed, followed, landed

SCALE, MEAN, STD = 5.0, 0.7, 0.3
GRID = emergence(8, SCALE)


def clean(x: Tensor, t: Tensor) -> Tensor:
    """Return E[x1 | x_t] for data N(MEAN, STD^2) and noise of deviation SCALE."""
    t = t[:, None]
    variance = t**2 * STD**2 + ((1 - t) * SCALE) ** 2
    return MEAN + t * STD**2 / variance * (x - t * MEAN)


def on_the_way(z: Tensor, t: Tensor) -> Tensor:
    """Place standard normal draws where the flow has them at time t: its map in closed form."""
    t = t[:, None]
    return t * MEAN + (t**2 * STD**2 + ((1 - t) * SCALE) ** 2).sqrt() * z


def intervals() -> tuple[Tensor, Tensor, Tensor]:
    """Give a row for each interval of the grid, and where it starts."""
    start, end = (torch.tensor(ends, dtype=torch.float64) for ends in zip(*pairwise(GRID), strict=True))
    return torch.randn(len(start), 4, dtype=torch.float64, generator=torch.Generator().manual_seed(0)), start, end


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("finest", [2, 8, 32])
def test_each_coarser_grid_is_every_second_time(grid, finest):
    times = GRIDS[grid](finest, SCALE)
    assert nested(times, finest) == list(times)
    assert nested(times, 1) == [0.0, 1.0]
    steps = finest
    while steps > 1:
        assert nested(times, steps // 2) == nested(times, steps)[::2]
        steps //= 2


@pytest.mark.parametrize("steps", [8, 4, 2])
def test_equal_ratios_stay_equal_around_the_middle(steps):
    ratios = [t / (1 - t) for t in nested(GRID, steps)[1:-1]]
    assert ratios[len(ratios) // 2] == pytest.approx(SCALE)
    grown = [b / a for a, b in pairwise(ratios)]
    assert grown == pytest.approx(grown[:1] * len(grown))


@pytest.mark.parametrize(("finest", "steps"), [(8, 3), (8, 16), (12, 4), (8, 0)])
def test_a_number_of_steps_that_halving_does_not_leave_is_refused(finest, steps):
    halves = {8: "8, 4, 2, 1", 12: "12, 6, 3"}[finest]
    with pytest.raises(ValueError, match=f"{steps} steps are not of a grid of {finest}; halving it leaves {halves}"):
        nested(GRIDS["uniform"](finest, 1.0), steps)


def test_aiming_undoes_landing():
    x, start, end = intervals()
    target = torch.randn_like(x)
    torch.testing.assert_close(aimed(x, landed(x, target, start, end), start, end), target)
    assert torch.equal(landed(x, target, start, end)[-1], x[-1] + (target - x)[-1])  # at 1: the data


def test_two_steps_that_aim_at_the_same_data_are_one():
    x, start, end = intervals()
    target, middle = torch.randn_like(x), (start + 2 * end) / 3
    twice = landed(landed(x, target, start, middle), target, middle, end)
    torch.testing.assert_close(twice, landed(x, target, start, end))


@pytest.mark.parametrize(("solver", "substeps", "error"), [("euler", 400, 2e-2), ("heun", 100, 2e-3)])
def test_the_teacher_is_followed_to_where_the_flow_goes(solver, substeps, error):
    """Of the last interval Euler's last substep leaves an error of its own length."""
    z, start, end = intervals()
    reached = followed(clean, on_the_way(z, start), start, end, substeps=substeps, solver=solver)
    torch.testing.assert_close(reached, on_the_way(z, end), rtol=0, atol=error)


def test_heun_is_of_second_order():
    z, start, end = (rows[:-1] for rows in intervals())
    errors = [
        (followed(clean, on_the_way(z, start), start, end, substeps=n, solver="heun") - on_the_way(z, end)).abs().max()
        for n in (8, 16)
    ]
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.15)


@pytest.mark.parametrize("solver", SOLVERS)
def test_single_precision_reaches_the_end(solver):
    """Leave no rest before 1, which a velocity would be divided by."""
    z, start, end = (rows.float() for rows in intervals())
    reached = followed(clean, on_the_way(z, start), start, end, substeps=3, solver=solver)
    assert reached.isfinite().all()
    assert (reached[-1] - on_the_way(z, end)[-1]).abs().max() < 0.2


def test_rows_of_different_intervals_do_not_meet():
    z, start, end = intervals()
    x = on_the_way(z, start)
    together = followed(clean, x, start, end, substeps=2, solver="heun")
    for i in range(len(x)):
        row = slice(i, i + 1)
        torch.testing.assert_close(
            followed(clean, x[row], start[row], end[row], substeps=2, solver="heun"), together[row]
        )

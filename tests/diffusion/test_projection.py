"""Test the projection of what an edit keeps: exact where it holds, and the rest as it was, on Gaussian data."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from kinema.diffusion.flow import Flow

SCALE = 5.0
CORRELATION = 0.8


def noises(rows: int, seed: int = 0):
    generator = torch.Generator().manual_seed(seed)
    while True:
        yield torch.randn(rows, 2, generator=generator, dtype=torch.float64)


def clean(covariance: Tensor):
    """Return E[x1 | x_t] for data N(0, covariance)."""

    def predict(x: Tensor, t: Tensor) -> Tensor:
        t = t[0]
        total = t**2 * covariance + ((1 - t) * SCALE) ** 2 * torch.eye(2, dtype=x.dtype)
        return x @ torch.linalg.solve(total, t * covariance)

    return predict


def sample(covariance: Tensor, renewal: float | None, rows: int = 20000, steps: int = 100) -> Tensor:
    """Hold the first of two values at .9."""
    flow = Flow(prediction="x1", source_scale=SCALE)
    known = torch.full((rows, 2), 0.9, dtype=torch.float64), torch.tensor([True, False]).expand(rows, 2)
    options = {"steps": steps, "grid": "emergence", "holding": "projection", "renewal": renewal}
    return flow.sample(clean(covariance), noises(rows), known=known, **options)


@pytest.mark.parametrize("renewal", [None, 0.5])
def test_what_is_held_is_exact(renewal):
    assert (sample(torch.eye(2, dtype=torch.float64), renewal, rows=100, steps=7)[:, 0] == 0.9).all()


@pytest.mark.parametrize(("renewal", "tolerance"), [(None, 0.02), (0.5, 0.06)])
def test_what_does_not_depend_on_it_keeps_its_distribution(renewal, tolerance):
    free = sample(torch.diag(torch.tensor([1.0, 0.25], dtype=torch.float64)), renewal)[:, 1]
    assert free.mean().item() == pytest.approx(0, abs=0.02)
    assert free.std().item() == pytest.approx(0.5, abs=tolerance)


@pytest.mark.parametrize(("renewal", "share"), [(None, 0.44), (0.5, 0.85)])
def test_how_far_what_depends_on_it_follows(renewal, share):
    """Compare with the conditional mean, correlation * held: the docstring's figures."""
    covariance = torch.tensor([[1.0, CORRELATION], [CORRELATION, 1.0]], dtype=torch.float64)
    assert sample(covariance, renewal)[:, 1].mean().item() / (CORRELATION * 0.9) == pytest.approx(share, abs=0.02)


def test_it_takes_one_noise_per_step_but_the_last():
    source, flow = noises(2), Flow(prediction="x1", source_scale=SCALE)
    known = torch.zeros(2, 2, dtype=torch.float64), torch.zeros(2, 2, dtype=torch.bool)
    flow.sample(clean(torch.eye(2, dtype=torch.float64)), source, steps=6, known=known, holding="projection")
    expected = noises(2)
    for _ in range(6):
        next(expected)
    assert torch.equal(next(source), next(expected))

"""Test classifier-free guidance."""

from __future__ import annotations

import pytest
import torch

from kinema.diffusion.ddpm import DDPM
from kinema.diffusion.flow import Flow
from kinema.diffusion.guidance import Guidance, guided


@pytest.mark.parametrize("scale", [0.0, 2.5, 4.5])
def test_halves_are_combined(scale):
    condition, empty, x = torch.randn(3, 2), torch.randn(3, 2), torch.randn(3, 2)
    result = guided(lambda x, t, c: x * c + t, condition, empty, scale)(x, torch.tensor([0.5]))
    with_text, without = x * condition + 0.5, x * empty + 0.5
    torch.testing.assert_close(result, without + scale * (with_text - without))


def test_scale_one_is_a_single_plain_pass():
    rows = []
    condition = torch.randn(3, 2)
    result = guided(lambda x, t, c: rows.append(len(x)) or c, condition, None, 1.0)(torch.randn(3, 2), torch.zeros(1))
    assert rows == [3]
    assert torch.equal(result, condition)


def test_no_empty_condition_is_named():
    with pytest.raises(ValueError, match=r"scale 2\.0 needs an empty condition; pass one, or scale 1"):
        guided(lambda x, t, c: c, torch.randn(3, 2), None, 2.0)


@pytest.mark.parametrize("process", [DDPM(50), Flow()])
def test_the_scale_follows_the_way_from_noise_to_data(process):
    """Read the scale off a model whose output is its condition, and count the passes."""
    times = [49.0, 39.0, 24.0, 9.0] if isinstance(process, DDPM) else [0.0, 0.2, 0.5, 0.8]
    sizes = []
    for guidance, expected in [
        (Guidance(3.0), [3, 3, 3, 3]),
        (Guidance(3.0, (0.1, 0.6)), [1, 3, 3, 1]),
        (Guidance(3.0, growing=True), [1, 1.4, 2, 2.6]),
        (Guidance(3.0, (0.3, 0.7), growing=True), [1, 1, 2, 1]),
    ]:
        sizes.clear()
        scale = guidance.along(process.progress)
        predict = guided(lambda x, t, c: sizes.append(len(c)) or c, torch.ones(2, 1), torch.zeros(2, 1), scale)
        found = [predict(torch.zeros(2, 1), torch.tensor([t]))[0].item() for t in times]
        assert found == pytest.approx(expected)
        assert sizes == [2 if value == 1 else 4 for value in expected]


@pytest.mark.parametrize("interval", [(0.5, 0.5), (-0.1, 0.5), (0.5, 1.1), (0.7, 0.2)])
def test_impossible_intervals_are_named(interval):
    with pytest.raises(ValueError, match="0 <= start < end <= 1, where 0 is noise and 1 is data"):
        Guidance(2.0, interval)

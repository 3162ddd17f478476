"""Test classifier-free guidance."""

from __future__ import annotations

import pytest
import torch

from kinema.diffusion.guidance import guided


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

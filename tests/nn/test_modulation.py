"""Test the adaLN block."""

from __future__ import annotations

import torch

from kinema.nn.modulation import AdaLNBlock


def test_untrained_block_is_the_identity():
    x = torch.randn(2, 4, 8)
    assert torch.equal(AdaLNBlock(8, heads=2, feedforward=16)(x, torch.randn(2, 8)), x)


def test_condition_and_padding():
    torch.manual_seed(0)
    block = AdaLNBlock(8, heads=2, feedforward=16).eval()
    torch.nn.init.normal_(block.modulation[1].weight)
    x, condition = torch.randn(2, 6, 8), torch.randn(2, 8)
    real = torch.arange(6)[None] < torch.tensor([[6], [4]])
    out = block(x, condition, real)
    torch.testing.assert_close(out[1:, :4], block(x[1:, :4], condition[1:]))
    assert not torch.allclose(out, block(x, condition.flip(0), real))

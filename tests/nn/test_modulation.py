"""Test the adaLN block."""

from __future__ import annotations

import torch

from kinema.nn.modulation import AdaLNBlock
from kinema.nn.rows import Rows


def test_untrained_block_is_the_identity():
    rows = Rows(torch.ones(2, 4, dtype=torch.bool))
    x = torch.randn(8, 8)
    assert torch.equal(AdaLNBlock(8, heads=2, feedforward=16)(x, rows, torch.randn(2, 8)), x)


def test_condition_and_padding():
    torch.manual_seed(0)
    block = AdaLNBlock(8, heads=2, feedforward=16).eval()
    torch.nn.init.normal_(block.modulation[1].weight)
    x, condition = torch.randn(2, 6, 8), torch.randn(2, 8)
    rows, alone = Rows(torch.arange(6)[None] < torch.tensor([[6], [4]])), Rows(torch.ones(1, 4, dtype=torch.bool))
    out = block(rows.pack(x), rows, condition)
    torch.testing.assert_close(out[6:], block(x[1, :4], alone, condition[1:]))
    assert not torch.allclose(out, block(rows.pack(x), rows, condition.flip(0)))

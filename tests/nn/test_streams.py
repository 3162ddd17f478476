"""Test rotary positions, the gated layer and the blocks of one and two streams."""

from __future__ import annotations

import torch

from kinema.nn.rotary import rotary
from kinema.nn.streams import CrossBlock, JointBlock
from kinema.nn.swiglu import SwiGLU


def test_rotary_products_see_differences_of_positions_alone():
    q, k = torch.randn(1, 1, 5, 8), torch.randn(1, 1, 5, 8)
    near, far = torch.arange(5), torch.arange(5) + 37
    products = [rotary(q, places) @ rotary(k, places).transpose(-1, -2) for places in (near, far)]
    torch.testing.assert_close(*products, rtol=1e-4, atol=1e-4)
    assert not torch.allclose(products[0], q @ k.transpose(-1, -2), atol=1e-2)


def test_rotary_keeps_norms_and_position_zero():
    x = torch.randn(2, 3, 4, 6)
    turned = rotary(x, torch.arange(4))
    torch.testing.assert_close(turned.norm(dim=-1), x.norm(dim=-1))
    torch.testing.assert_close(turned[:, :, 0], x[:, :, 0])


def test_rotary_turns_interleaved_pairs():
    """Compare with complex numbers: (x0 + i x1) e^(i position), for the first pair."""
    x = torch.randn(1, 1, 3, 4)
    pair = torch.view_as_complex(x[0, 0, :, :2].contiguous())
    expected = torch.view_as_real(pair * torch.polar(torch.ones(3), torch.arange(3.0)))
    torch.testing.assert_close(rotary(x, torch.arange(3))[0, 0, :, :2], expected)


def test_swiglu_is_gated():
    layer = SwiGLU(4, 6)
    x = torch.randn(3, 4)
    gate, value = (x @ layer.spread.weight.T).split(6, dim=-1)
    torch.testing.assert_close(layer(x), (gate * torch.sigmoid(gate) * value) @ layer.gather.weight.T)


def test_blocks_start_as_the_identity():
    motion, text, condition = torch.randn(2, 5, 8), torch.randn(2, 3, 8), torch.randn(2, 8)
    mask, positions = torch.ones(2, 1, 1, 8, dtype=torch.bool), torch.arange(5)
    out = JointBlock(8, 2, 12)(motion, text, condition, positions, mask)
    assert torch.equal(out[0], motion)
    assert torch.equal(out[1], text)
    alone = CrossBlock(8, 2, 12, cross=True)(motion, condition, positions, None, text)
    assert torch.equal(alone, motion)


def test_shared_modulation_adds_an_offset_of_the_blocks_own():
    torch.manual_seed(0)
    block = CrossBlock(8, 2, 12, shared=True)
    x, table = torch.randn(2, 5, 8), torch.randn(2, 48)
    moved = block(x, table, torch.arange(5))
    assert not torch.equal(moved, x)
    torch.nn.init.constant_(block.stream.modulation.offset, 0.5)
    torch.testing.assert_close(block(x, table - 0.5, torch.arange(5)), moved)

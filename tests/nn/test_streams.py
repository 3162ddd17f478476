"""Test rows, rotary positions, the gated layer and the blocks of one and two streams."""

from __future__ import annotations

import torch

from kinema.nn.rotary import rotary
from kinema.nn.rows import Rows
from kinema.nn.streams import CrossBlock, JointBlock
from kinema.nn.swiglu import SwiGLU
from kinema.types import frame_mask


def test_rotary_products_see_differences_of_positions_alone():
    q, k = torch.randn(5, 1, 8), torch.randn(5, 1, 8)
    products = [
        rotary(q, places)[:, 0] @ rotary(k, places)[:, 0].T for places in (torch.arange(5), torch.arange(5) + 37)
    ]
    torch.testing.assert_close(*products, rtol=1e-4, atol=1e-4)
    assert not torch.allclose(products[0], q[:, 0] @ k[:, 0].T, atol=1e-2)


def test_rotary_keeps_norms_and_position_zero():
    x = torch.randn(4, 3, 6)
    turned = rotary(x, torch.arange(4))
    torch.testing.assert_close(turned.norm(dim=-1), x.norm(dim=-1))
    torch.testing.assert_close(turned[0], x[0])


def test_rotary_turns_interleaved_pairs():
    """Compare with complex numbers: (x0 + i x1) e^(i position), for the first pair."""
    x = torch.randn(3, 1, 4)
    pair = torch.view_as_complex(x[:, 0, :2].contiguous())
    expected = torch.view_as_real(pair * torch.polar(torch.ones(3), torch.arange(3.0)))
    torch.testing.assert_close(rotary(x, torch.arange(3))[:, 0, :2], expected)


def test_swiglu_is_gated():
    layer = SwiGLU(4, 6)
    x = torch.randn(3, 4)
    gate, value = (x @ layer.spread.weight.T).split(6, dim=-1)
    torch.testing.assert_close(layer(x), (gate * torch.sigmoid(gate) * value) @ layer.gather.weight.T)


def test_blocks_start_as_the_identity():
    frames, words = Rows(frame_mask(torch.tensor([5, 2]), 5)), Rows(frame_mask(torch.tensor([1, 3]), 3))
    motion, text, condition = torch.randn(7, 8), torch.randn(4, 8), torch.randn(2, 8)
    mask = torch.cat((words.real, frames.real), dim=1)[:, None, None]
    out = JointBlock(8, 2, 12)(motion, frames, text, words, condition, mask)
    assert torch.equal(out[0], motion)
    assert torch.equal(out[1], text)
    own = frames.real[:, None, None]
    block = CrossBlock(8, 2, 12, cross=True)
    assert torch.equal(block(motion, frames, condition, own, block.cross.read(text, words), words.real), motion)


def test_shared_modulation_adds_an_offset_of_the_blocks_own():
    torch.manual_seed(0)
    block, rows = CrossBlock(8, 2, 12, shared=True), Rows(frame_mask(torch.tensor([5, 3]), 5))
    x, table, mask = torch.randn(8, 8), torch.randn(2, 48), rows.real[:, None, None]
    moved = block(x, rows, table, mask)
    assert not torch.equal(moved, x)
    torch.nn.init.constant_(block.stream.modulation.offset, 0.5)
    torch.testing.assert_close(block(x, rows, table - 0.5, mask), moved)

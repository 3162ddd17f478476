"""Test attention: masks, context and agreement with torch's own module."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from kinema.nn.attention import Attention


@pytest.fixture
def attention():
    torch.manual_seed(0)
    return Attention(12, heads=3, dropout=0.5).eval()


def test_equals_torch(attention):
    oracle = nn.MultiheadAttention(12, 3, batch_first=True).eval()
    parts = (attention.query, attention.key, attention.value)
    with torch.no_grad():
        oracle.in_proj_weight.copy_(torch.cat([part.weight for part in parts]))
        oracle.in_proj_bias.copy_(torch.cat([part.bias for part in parts]))
        oracle.out_proj.load_state_dict(attention.proj.state_dict())
    x, context = torch.randn(2, 5, 12), torch.randn(2, 7, 12)
    seen = torch.rand(2, 7) < 0.6
    seen[:, 0] = True
    expected, _ = oracle(x, context, context, key_padding_mask=~seen)
    torch.testing.assert_close(attention(x, seen, context), expected)


def test_masked_keys_have_no_influence(attention):
    x = torch.randn(1, 6, 12)
    alone = attention(x[:, :4])
    padded = attention(x, torch.arange(6)[None] < 4)
    torch.testing.assert_close(padded[:, :4], alone)


def test_pair_mask_is_causal(attention):
    x = torch.randn(1, 5, 12)
    causal = torch.ones(5, 5, dtype=torch.bool).tril()[None]
    changed = x.clone()
    changed[:, 3:] += 1
    torch.testing.assert_close(attention(x, causal)[:, :3], attention(changed, causal)[:, :3])


def test_heads_that_do_not_divide_the_width():
    with pytest.raises(ValueError, match="width 10 is not a multiple of heads 4"):
        Attention(10, heads=4)

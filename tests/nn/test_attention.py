"""Test attention: masks, context and agreement with torch's own module."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from kinema.nn.attention import LONG, Attention, KeyValueCache
from kinema.nn.rows import Rows


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


LENGTHS = torch.tensor([4, 0, LONG, 1])
"""Rows of a batch that a CPU attends to one sequence after the other."""


@pytest.mark.parametrize("lengths", [LENGTHS, LENGTHS.clamp(max=6), torch.full((4,), 6)])
def test_rows_attend_to_their_own_sequence(attention, lengths):
    size = int(lengths.max())
    x, context, seen = torch.randn(4, size, 12), torch.randn(4, 5, 12), torch.rand(4, 5) < 0.7
    seen[:, 0] = True
    rows = Rows(torch.arange(size) < lengths[:, None])
    packed = rows.pack(x)
    expected = rows.pack(attention(x, rows.real))
    torch.testing.assert_close(attention(packed, rows=rows), expected)
    everything = torch.ones(1, size, size, dtype=torch.bool)  # shows padding, which stays hidden
    torch.testing.assert_close(attention(packed, everything, rows=rows), expected)
    torch.testing.assert_close(attention(packed, seen, context, rows=rows), rows.pack(attention(x, seen, context)))
    causal = everything.tril()
    torch.testing.assert_close(attention(packed, causal, rows=rows), rows.pack(attention(x, causal)))


def test_rows_have_no_cache(attention):
    rows = Rows.of(torch.zeros(1, 4))
    with pytest.raises(ValueError, match="a cache holds positions of padded sequences"):
        attention(torch.randn(4, 12), cache=KeyValueCache(4), rows=rows)


def test_gradients_of_rows_are_those_of_padding(attention):
    x, rows = torch.randn(4, LONG, 12, requires_grad=True), Rows(torch.arange(LONG) < LENGTHS[:, None])
    weight = torch.randn(int(LENGTHS.sum()), 12)
    found = [
        torch.autograd.grad((weight * made).sum(), (x, *attention.parameters()))
        for made in (attention(rows.pack(x), rows=rows), rows.pack(attention(x, rows.real)))
    ]
    for ours, padded in zip(*found, strict=True):
        torch.testing.assert_close(ours, padded, rtol=1e-4, atol=1e-5)


def test_heads_that_do_not_divide_the_width():
    with pytest.raises(ValueError, match="width 10 is not a multiple of heads 4"):
        Attention(10, heads=4)


def test_dropout_acts_in_training_on_probabilities_and_output():
    torch.manual_seed(0)
    attention, x = Attention(64, 4, dropout=0.5).train(), torch.randn(2, 40, 64)
    rows = Rows(torch.arange(40) < torch.tensor([[40], [33]]))
    for made in (attention(x), attention(rows.pack(x), rows=rows)):
        assert (made == 0).float().mean().item() == pytest.approx(0.5, abs=0.05)
    attention.proj = nn.Identity()
    kept = [attention(x) for _ in range(2)]
    both = (kept[0] != 0) & (kept[1] != 0)
    assert not torch.allclose(kept[0][both], kept[1][both])

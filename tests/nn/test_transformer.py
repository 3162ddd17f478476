"""Test transformer blocks: agreement with torch's encoder layer, and cached steps equal to the whole sequence."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from kinema.nn.attention import KeyValueCache
from kinema.nn.transformer import TransformerBlock, run


def oracle(block: TransformerBlock, *, first: bool) -> nn.TransformerEncoderLayer:
    layer = nn.TransformerEncoderLayer(12, 3, 20, activation="gelu", batch_first=True, norm_first=first).eval()
    parts = (block.attention.query, block.attention.key, block.attention.value)
    with torch.no_grad():
        layer.self_attn.in_proj_weight.copy_(torch.cat([p.weight for p in parts]))
        layer.self_attn.in_proj_bias.copy_(torch.cat([p.bias for p in parts]))
    for ours, theirs in (
        (block.attention.proj, layer.self_attn.out_proj),
        (block.mlp[0], layer.linear1),
        (block.mlp[3], layer.linear2),
        (block.norm1, layer.norm1),
        (block.norm2, layer.norm2),
    ):
        theirs.load_state_dict(ours.state_dict())
    return layer


@pytest.mark.parametrize("norm", ["pre", "post"])
def test_equals_torch(norm):
    torch.manual_seed(0)
    block = TransformerBlock(12, 3, 20, 0.1, norm=norm).eval()
    x, real = torch.randn(2, 5, 12), torch.arange(5) < torch.tensor([[5], [3]])
    expected = oracle(block, first=norm == "pre")(x, src_key_padding_mask=~real)
    torch.testing.assert_close(block(x, real)[real], expected[real], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("norm", ["pre", "post"])
def test_cached_steps_equal_the_whole_sequence(norm):
    torch.manual_seed(0)
    blocks = nn.ModuleList(TransformerBlock(12, 3, 20, norm=norm) for _ in range(2)).eval()
    x = torch.randn(2, 6, 12)
    whole = run(blocks, x, torch.ones(6, 6, dtype=torch.bool).tril()[None])
    caches = [KeyValueCache(6) for _ in blocks]
    steps = torch.cat([run(blocks, x[:, i : i + 1], caches=caches) for i in range(6)], dim=1)
    torch.testing.assert_close(steps, whole, rtol=1e-4, atol=1e-5)
    with pytest.raises(ValueError, match="cache of 6 positions cannot take 7"):
        run(blocks, x[:, :1], caches=caches)


def test_unknown_norm():
    with pytest.raises(ValueError, match="norm 'mid' is unknown"):
        TransformerBlock(12, 3, 20, norm="mid")


@pytest.mark.parametrize(("norm", "shares"), [("pre", [0.0, 0.1]), ("post", [0.1, 0.1])])
def test_dropout_of_the_mlp(norm, shares):
    block = TransformerBlock(8, 2, 12, 0.1, norm=norm)
    assert [part.p for part in block.mlp if isinstance(part, nn.Dropout)] == shares

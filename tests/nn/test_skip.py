"""Test the skip transformer: its connections, its start, its padding (the published one: tests/parity/test_mld.py)."""

from __future__ import annotations

import pytest
import torch

from kinema.nn.rows import Rows
from kinema.nn.skip import SkipTransformer


def make(cross: bool = False, layers: int = 5) -> SkipTransformer:
    torch.manual_seed(0)
    return SkipTransformer(8, 2, 12, layers, 0.1, cross=cross)


@pytest.mark.parametrize("cross", [False, True])
def test_blocks_start_with_the_same_biases_and_matrices_of_their_own(cross):
    model = make(cross)
    for first, second in zip(model.inputs[0].named_parameters(), model.outputs[1].named_parameters(), strict=True):
        assert torch.equal(first[1], second[1]) == (first[1].ndim == 1), first[0]
    assert torch.equal(model.merges[0].bias, model.merges[1].bias)
    assert not torch.equal(model.merges[0].weight, model.merges[1].weight)


@pytest.mark.parametrize("cross", [False, True])
def test_each_block_behind_the_middle_reads_its_mirror(cross):
    model = make(cross).eval()
    x, context = torch.randn(2, 4, 8), torch.randn(2, 3, 8) if cross else None
    rows = Rows.of(x)
    before = model(rows.pack(x), rows, context)
    with torch.no_grad():  # merges that let the mirror's half through alone
        for merge in model.merges:
            merge.weight.copy_(torch.cat((torch.zeros(8, 8), torch.eye(8)), dim=1))
            merge.bias.zero_()
    first = model.inputs[0](x) if context is None else model.inputs[0](x, context)
    last = model.outputs[1](first) if context is None else model.outputs[1](first, context)
    after = model(rows.pack(x), rows, context)
    torch.testing.assert_close(rows.pad(after), model.norm(last))
    assert not torch.allclose(after, before)


def test_padding_is_not_seen():
    model, x = make().eval(), torch.randn(2, 4, 8)
    real = torch.tensor([[True, True, True, False], [True] * 4])
    rows, alone = Rows(real), Rows.of(x[:1, :3])
    made = model(rows.pack(x), rows)
    torch.testing.assert_close(made[:3], model(x[0, :3], alone))
    torch.testing.assert_close(rows.pad(made)[real], made)


@pytest.mark.parametrize("layers", [0, 4])
def test_without_a_middle_it_is_refused(layers):
    with pytest.raises(ValueError, match=f"layers={layers}; give an odd number"):
        SkipTransformer(8, 2, 12, layers)

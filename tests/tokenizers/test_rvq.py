"""Residual layers: each quantises the rest, inactive ones stay out, and the gradient counts the active ones."""

from __future__ import annotations

import pytest
import torch

from kinema.tokenizers.rvq import ResidualQuantizer

SIZE, DIM, LAYERS = 16, 4, 3
REAL = torch.arange(6) < torch.tensor([6, 4])[:, None]


def rows(seed: int, batch=2) -> torch.Tensor:
    return torch.randn(batch, 6, DIM, generator=torch.Generator().manual_seed(seed))


def make(**options) -> ResidualQuantizer:
    quantizer = ResidualQuantizer(SIZE, DIM, quantizers=LAYERS, **options).train()
    for step in range(4):
        quantizer(rows(step), REAL, torch.Generator().manual_seed(step), active=LAYERS)
    return quantizer


def test_every_layer_quantises_what_is_left():
    quantizer, z = make().eval(), rows(9)
    result, residual = quantizer(z, REAL), z
    for i, layer in enumerate(quantizer.layers):
        codes = result.codes[..., i, None]
        nearest = torch.cdist(residual, layer.codebook.expand(2, -1, -1)).argmin(-1)
        assert torch.equal(codes[..., 0][REAL], nearest[REAL])
        residual = residual - layer.lookup(codes)
    torch.testing.assert_close(quantizer.lookup(result.codes)[REAL], (z - residual)[REAL])
    torch.testing.assert_close(result.values[REAL], (z - residual)[REAL])


@pytest.mark.parametrize("active", range(1, LAYERS + 1))
def test_inactive_layers_stay_out(active):
    quantizer, z = make(), rows(9).requires_grad_()
    before = [layer.codebook.clone() for layer in quantizer.layers]
    result = quantizer(z, REAL, torch.Generator().manual_seed(0), active=active)
    assert (result.codes[REAL][:, active:] == -1).all()
    assert (result.codes[REAL][:, :active] >= 0).all()
    assert not result.codes[~REAL].any()
    changed = [not torch.equal(a, layer.codebook) for a, layer in zip(before, quantizer.layers, strict=True)]
    assert changed == [i < active for i in range(LAYERS)]
    result.values.sum().backward()
    assert torch.equal(z.grad, float(active) * REAL[..., None].expand_as(z))


def test_dropout_of_layers_is_drawn_in_training_only():
    quantizer, generator = make(quantizer_dropout=0.5), torch.Generator().manual_seed(0)
    counts = [int((quantizer(rows(0), REAL, generator).codes[0, 0] >= 0).sum()) for _ in range(300)]
    share = torch.bincount(torch.tensor(counts), minlength=LAYERS + 1)[1:] / 300
    torch.testing.assert_close(share, torch.tensor([1 / 6, 1 / 6, 4 / 6]), rtol=0, atol=0.08)
    assert {int((quantizer.eval()(rows(0), REAL).codes >= 0).sum()) for _ in range(9)} == {2 * 6 * LAYERS}


def test_codes_are_drawn_in_training_only():
    quantizer, z = make(temperature=2.0, quantizer_dropout=0.0), rows(9)
    drawn = [quantizer(z, REAL, torch.Generator().manual_seed(s)).codes for s in (1, 1 + 2**20)]
    assert not torch.equal(*drawn)
    quantizer.eval()
    assert torch.equal(*(quantizer(z, REAL, torch.Generator().manual_seed(s)).codes for s in (1, 2)))


def test_the_order_of_a_batch_changes_nothing():
    quantizer = make().eval()
    assert torch.equal(quantizer(rows(9).flip(0), REAL.flip(0)).codes.flip(0), quantizer(rows(9), REAL).codes)


def test_lookup_of_fewer_layers_or_none():
    quantizer = make().eval()
    codes = quantizer(rows(9), REAL).codes
    shorter = codes.clone()
    shorter[..., 1:] = -1
    assert torch.equal(quantizer.lookup(shorter), quantizer.lookup(codes[..., :1]))
    assert not quantizer.lookup(torch.full_like(codes, -1)).any()
    with pytest.raises(ValueError, match=f"{LAYERS + 1} codes per position; this tokenizer has 1 to {LAYERS}"):
        quantizer.lookup(torch.zeros(1, 2, LAYERS + 1, dtype=torch.long))
    with pytest.raises(ValueError, match=f"id {SIZE} is out of range"):
        quantizer.lookup(torch.full_like(codes, SIZE))


def test_no_layers_are_named():
    with pytest.raises(ValueError, match=r"ResidualQuantizer.quantizers=0: must be a whole number from 1"):
        ResidualQuantizer(4, 2, quantizers=0)

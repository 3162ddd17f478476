"""Test rows: packing and padding are each other's inverse, and a whole batch is not copied."""

from __future__ import annotations

import torch

from kinema.nn.rows import Rows

REAL = torch.tensor([[True, True, False], [False, False, False], [True, False, True]])


def test_rows_know_their_sequence_and_place():
    rows = Rows(REAL)
    assert rows.owner.tolist() == [0, 0, 2, 2]
    assert rows.place.tolist() == [0, 1, 0, 2]
    assert rows.counts == [2, 0, 2]
    assert not rows.whole


def test_padding_undoes_packing_and_is_zero_elsewhere():
    rows, x = Rows(REAL), torch.randn(3, 3, 4, requires_grad=True)
    padded = rows.pad(rows.pack(x))
    assert torch.equal(padded, x * REAL[..., None])
    padded.sum().backward()
    assert torch.equal(x.grad, REAL[..., None].expand(3, 3, 4).float())


def test_a_whole_batch_is_not_copied():
    x = torch.randn(2, 3, 4)
    for rows in (Rows.of(x), Rows(torch.ones(2, 3, dtype=torch.bool))):
        assert rows.whole
        assert rows.pack(x).data_ptr() == rows.pad(rows.pack(x)).data_ptr() == x.data_ptr()
        assert rows.owner.tolist() == [0, 0, 0, 1, 1, 1]


def test_conditions_stand_before_each_sequence():
    rows = Rows.behind(2, REAL)
    assert rows.real.shape == (3, 5)
    assert rows.real[:, :2].all()
    assert torch.equal(rows.real[:, 2:], REAL)
    assert rows.spread(torch.arange(3.0)[:, None])[:, 0].tolist() == [0, 0, 0, 0, 1, 1, 2, 2, 2, 2]

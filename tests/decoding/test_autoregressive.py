"""Test decoding from left to right: what is written, what is kept, where samples end and when the loop does."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from kinema.decoding.autoregressive import decode_left_to_right
from kinema.decoding.draws import Greedy

END = 9


class Script:
    """Predict the tokens of a table, and remember what each call saw."""

    def __init__(self, table: list[list[int]]) -> None:
        self.table = torch.tensor(table)
        self.seen: list[Tensor] = []

    def __call__(self, step: int, ids: Tensor) -> Tensor:
        self.seen.append(ids.clone())
        return F.one_hot(self.table[:, step], END + 1).float()

    def decode(self, lengths: list[int], start: Tensor | None = None, **options) -> tuple[Tensor, Tensor]:
        start = torch.full_like(self.table, -1) if start is None else start
        draws = Greedy(torch.zeros(len(lengths), dtype=torch.long))
        return decode_left_to_right(self, start, torch.tensor(lengths), draws, **options)


def test_slots_below_the_length_are_filled_in_order():
    script = Script([[1, 2, 3], [4, 5, 6]])
    ids, lengths = script.decode([3, 2])
    assert ids.tolist() == [[1, 2, 3], [4, 5, -1]]
    assert lengths.tolist() == [3, 2]
    assert [seen.tolist() for seen in script.seen] == [
        [[-1, -1, -1], [-1, -1, -1]],
        [[1, -1, -1], [4, -1, -1]],
        [[1, 2, -1], [4, 5, -1]],
    ]


def test_samples_that_ended_stop_changing_and_the_loop_ends_with_the_last():
    script = Script([[1, END, 3, 3, 3], [END, 5, 5, 5, 5], [1, 2, 3, END, 5]])
    ids, lengths = script.decode([5, 5, 5], end=END)
    assert ids.tolist() == [[1, -1, -1, -1, -1], [-1, -1, -1, -1, -1], [1, 2, 3, -1, -1]]
    assert lengths.tolist() == [1, 0, 3]
    assert len(script.seen) == 4


def test_a_sample_that_never_ends_has_all_slots():
    ids, lengths = Script([[1, 2, 3]]).decode([3], end=END)
    assert (ids.tolist(), lengths.tolist()) == ([[1, 2, 3]], [3])


def test_kept_slots_stay_and_cannot_end_a_sample():
    start = torch.tensor([[7, -1, 7, -1], [-1, 7, -1, 7]])
    script = Script([[1, 2, END, 4], [5, END, END, 8]])
    ids, lengths = script.decode([4, 4], start, keep=start == 7, end=END)
    assert ids.tolist() == [[7, 2, 7, 4], [5, 7, -1, 7]]
    assert lengths.tolist() == [4, 2]
    assert script.seen[2].tolist() == [[7, 2, 7, -1], [5, 7, -1, 7]]


def test_the_start_is_left_alone():
    start, lengths = torch.full((1, 2), -1), torch.tensor([2])
    decode_left_to_right(Script([[1, END]]), start, lengths, Greedy(torch.tensor([0])), end=END)
    assert (start.tolist(), lengths.tolist()) == ([[-1, -1]], [2])

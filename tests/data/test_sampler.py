from __future__ import annotations

from itertools import chain

import pytest

from kinema.data.sampler import StepSampler


def test_an_epoch_sees_every_item_once_but_the_leftover():
    batches = list(StepSampler(size=23, batch_size=5, seed=1, steps=8))
    for epoch in (batches[:4], batches[4:]):
        indices = [index for batch in epoch for index, _ in batch]
        assert len(set(indices)) == 20
    assert batches[:4] != batches[4:]


def test_batches_are_a_function_of_seed_and_step():
    whole = list(StepSampler(23, 5, seed=1, steps=11))
    for start in (0, 3, 4, 9):
        assert list(StepSampler(23, 5, seed=1, steps=11, start_step=start)) == whole[start:]
    assert list(StepSampler(23, 5, seed=2, steps=11)) != whole


def test_length_counts_all_steps_also_after_resuming():
    assert len(StepSampler(23, 5, seed=1, steps=11, start_step=7)) == 11


@pytest.mark.parametrize("world", [2, 3, 6])
def test_ranks_share_the_global_batch(world):
    whole = list(StepSampler(40, 12, seed=3, steps=7))
    ranks = [list(StepSampler(40, 12, seed=3, steps=7, rank=rank, world=world)) for rank in range(world)]
    assert [list(chain(*parts)) for parts in zip(*ranks, strict=True)] == whole


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"size": 3, "batch_size": 4}, "at most the 3 items"),
        ({"size": 9, "batch_size": 4, "world": 3}, "multiple of 3"),
        ({"size": 9, "batch_size": 4, "rank": 2, "world": 2}, "rank 2"),
    ],
)
def test_impossible_batches_are_refused(arguments, says):
    with pytest.raises(ValueError, match=says):
        StepSampler(**arguments, seed=0, steps=1)

"""Test that any number of ranks, resumed at any step, sees the batches of one process."""

from __future__ import annotations

from itertools import chain

from hypothesis import given
from hypothesis import strategies as st

from kinema.data.datasets import crop_frames
from kinema.data.sampler import StepSampler


@given(st.integers(1, 4), st.integers(1, 4), st.integers(0, 9), st.integers(0, 99), st.integers(0, 8))
def test_ranks_share_the_batches_of_one_process_from_any_step_on(world, share, spare, seed, start):
    batch = world * share
    whole = list(StepSampler(batch + spare, batch, seed, steps=8))
    ranks = [StepSampler(batch + spare, batch, seed, 8, start, rank, world) for rank in range(world)]
    assert [list(chain(*parts)) for parts in zip(*ranks, strict=True)] == whole[start:]


@given(st.integers(1, 400), st.integers(1, 8))
def test_a_crop_is_of_whole_units_and_fits(length, unit):
    for frames in crop_frames(max(length, unit), unit):
        assert frames % unit == 0
        assert unit <= frames <= max(length, unit)

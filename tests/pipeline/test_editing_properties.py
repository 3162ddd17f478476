"""Test that ranges of frames read back as written, and that what is edited and what is kept make the whole clip."""

from __future__ import annotations

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from kinema.pipeline.editing import TASKS, complement, edited_frames, parse_ranges, resolve_ranges

LENGTHS = st.integers(1, 200)


@st.composite
def cuts(draw) -> tuple[int, list[tuple[int, int]]]:
    """Draw a length and ranges of its frames; they may touch and overlap."""
    length = draw(LENGTHS)
    starts = draw(st.lists(st.integers(0, length - 1), min_size=1, max_size=4))
    return length, [(start, draw(st.integers(start + 1, length))) for start in starts]


@given(cuts(), st.floats(1, 120))
def test_frames_read_back_as_written(case, fps):
    length, ranges = case
    assert parse_ranges(",".join(f"{start}:{end}" for start, end in ranges), length, fps) == ranges


@given(cuts(), st.sampled_from([12.5, 20.0, 30.0]))
def test_seconds_are_those_of_the_frames(case, fps):
    length, ranges = case
    assert parse_ranges(",".join(f"{start / fps}s:{end / fps}s" for start, end in ranges), length, fps) == ranges


@given(cuts())
def test_kept_and_edited_frames_make_the_clip(case):
    length, ranges = case
    kept = complement(ranges, length)
    edited, rest = edited_frames([ranges], length), edited_frames([kept], length)
    assert (edited ^ rest).all()
    assert all(before < start for (_, before), (start, _) in pairwise(kept))
    assert complement(complement(kept, length), length) == kept


@given(st.sampled_from(sorted(TASKS)), st.lists(LENGTHS, min_size=1, max_size=4))
def test_tasks_stay_inside_their_clips(task, lengths):
    for ranges, length in zip(resolve_ranges(task, lengths), lengths, strict=True):
        assert all(0 <= start < end <= length for start, end in ranges)

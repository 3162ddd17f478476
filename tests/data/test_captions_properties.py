"""Test that sides are swapped once and for all, and that caption lines read back as written."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from kinema.data.captions import AnnotatedCaption, parse_line, swap_sides
from kinema.data.synthetic.folders import format_caption
from kinema.types import Caption

SIDED = ("left", "Right", "LEFT", "clockwise", "counterclockwise", "left-handed", "rightward", "left/ADJ", "leftmost")
PLAIN = ("a", "man", "turns", "walks", "bright", "leftover", "step/NOUN", "arm", ",")
WORDS = st.lists(st.sampled_from(SIDED + PLAIN), min_size=1, max_size=8)
TOKENS = st.lists(st.sampled_from(("a/DET", "left/ADJ", "step/NOUN", "and/or/CCONJ", "/X", "1/NUM")))
SECONDS = st.floats(0, 500).map(lambda s: round(s, 2))


@given(WORDS.map(" ".join))
def test_swapping_twice_is_the_identity(text):
    assert swap_sides(swap_sides(text)) == text


@given(WORDS)
def test_every_side_is_swapped_and_nothing_else(words):
    swapped = swap_sides(" ".join(words)).split()
    assert [a != b for a, b in zip(words, swapped, strict=True)] == [word in SIDED for word in words]


@given(WORDS, TOKENS, SECONDS, SECONDS)
def test_a_caption_line_reads_back_as_written(words, tokens, start, end):
    caption = AnnotatedCaption(Caption(" ".join(words), tuple(tokens)), start, end)
    assert parse_line(format_caption(caption)) == caption


@given(WORDS.filter(lambda words: not all("/" in word for word in words)), st.sampled_from(["", " ", "("]))
def test_a_bare_caption_may_hold_a_sign(words, sign):
    caption = " ".join(words)
    assert parse_line(f"set {sign}#3 of {caption}").caption == Caption(f"set {sign}#3 of {caption}")

"""Test what must hold of masks and counts whatever the lengths, scores and orders are."""

from __future__ import annotations

import torch
from hypothesis import given
from hypothesis import strategies as st

from kinema.masking import (
    DIRECTIONS,
    cosine_counts,
    hybrid_mask,
    lowest,
    masked_count,
    official_inference_mask,
    ranks,
    shrinking_counts,
)
from kinema.types import frame_mask

SLOTS = 6
LENGTHS = st.lists(st.integers(1, 60), min_size=1, max_size=4).map(torch.tensor)
FLAGS = st.lists(st.lists(st.booleans(), min_size=SLOTS, max_size=SLOTS), min_size=3, max_size=3).map(torch.tensor)
# Few values, so that there are ties.
SCORES = st.lists(
    st.lists(st.sampled_from([-1.5, 0.0, 0.25, 3.0]), min_size=SLOTS, max_size=SLOTS), min_size=3, max_size=3
)


@given(SCORES.map(torch.tensor), FLAGS, st.lists(st.integers(0, 8), min_size=3, max_size=3).map(torch.tensor))
def test_lowest_takes_as_many_eligible_ones_as_there_are_and_none_above_the_others(scores, eligible, count):
    chosen = lowest(scores, eligible, count)
    assert not (chosen & ~eligible).any()
    assert torch.equal(chosen.sum(1), count.minimum(eligible.sum(1)))
    most = scores.masked_fill(~chosen, -torch.inf).amax(1)
    least = scores.masked_fill(~eligible | chosen, torch.inf).amin(1)
    assert (most <= least).all()


@given(SCORES.map(torch.tensor))
def test_ranks_number_a_row_in_the_order_of_its_scores(scores):
    order = ranks(scores).argsort(1)
    assert torch.equal(ranks(scores).sort(1).values, torch.arange(SLOTS).expand(3, -1))
    assert (scores.gather(1, order).diff(dim=1) >= 0).all()


@given(LENGTHS, st.floats(0, 1))
def test_a_share_masks_at_least_one_position_and_no_padding(lengths, ratio):
    count = masked_count(lengths, torch.full(lengths.shape, ratio))
    assert ((count >= 1) & (count <= lengths)).all()


@given(LENGTHS, st.integers(1, 30))
def test_counts_start_with_all_positions_and_never_grow(lengths, steps):
    for counts in (cosine_counts(lengths, steps), shrinking_counts(lengths, steps)):
        assert counts.shape == (steps, len(lengths))
        assert torch.equal(counts[0], lengths)
        assert (counts.diff(dim=0) <= 0).all()
        assert (counts >= 1).all()


@st.composite
def hybrids(draw) -> tuple[tuple[torch.Tensor, ...], dict[str, int | bool | str]]:
    """Draw orders, masked tokens, lengths (with room for END) and rules."""
    lengths = torch.tensor(draw(st.lists(st.integers(1, SLOTS - 1), min_size=3, max_size=3)))
    orders = torch.tensor([draw(st.permutations(range(SLOTS))) for _ in range(3)])
    masked = draw(FLAGS) & frame_mask(lengths, SLOTS)
    rules = {"conditions": draw(st.integers(1, 2)), "unmasked_see_masks": draw(st.booleans())}
    return (orders, masked, lengths), rules | {"direction": draw(st.sampled_from(DIRECTIONS))}


@given(hybrids())
def test_conditions_are_seen_by_all_and_padding_by_nobody(case):
    (orders, masked, lengths), rules = case
    seen = hybrid_mask(orders, masked, lengths, **rules)
    assert seen[:, :, : rules["conditions"]].all()
    tokens = seen[:, :, rules["conditions"] :]
    assert not tokens[~frame_mask(lengths + 1, SLOTS)[:, None].expand_as(tokens)].any()


@given(hybrids())
def test_of_two_masked_tokens_one_sees_the_other_and_each_sees_itself(case):
    (orders, masked, lengths), rules = case
    start = rules["conditions"]
    among = hybrid_mask(orders, masked, lengths, **rules)[:, start:, start:]
    both = masked[:, :, None] & masked[:, None, :]
    itself = torch.eye(SLOTS, dtype=torch.bool)
    assert among[both & itself].all()
    assert (among ^ among.mT)[both & ~itself].all()


@given(hybrids())
def test_turning_the_order_round_is_the_other_direction(case):
    (orders, masked, lengths), rules = case
    other = {"ge": "le", "le": "ge"}[rules["direction"]]
    turned = hybrid_mask(-orders, masked, lengths, **rules | {"direction": other})
    assert torch.equal(hybrid_mask(orders, masked, lengths, **rules), turned)


@given(hybrids())
def test_the_published_inference_mask_shows_what_was_decoded_and_hides_nothing_more(case):
    (orders, free, lengths), rules = case
    start = hybrid_mask(orders, free, lengths, **rules)
    masked = free & (orders % 2 == 0)
    shown = official_inference_mask(orders, free, masked, lengths, **rules)
    assert (start <= shown).all()
    columns = shown[:, :, rules["conditions"] :]
    assert columns[(free & ~masked)[:, None].expand_as(columns)].all()

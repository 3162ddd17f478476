"""Test that every free position is decoded once, whatever is free and however many are masked at each step."""

from __future__ import annotations

import torch
from hypothesis import given
from hypothesis import strategies as st

from kinema.decoding.draws import SeededDraws, uniform
from kinema.decoding.token_unmasking import choice, unmask_tokens
from kinema.decoding.unmasking import plan_unmasking, unmask
from kinema.masking import cosine_counts

SIZE, CLASSES = 9, 5
SEEDS = st.lists(st.integers(-(2**63), 2**63 - 1), min_size=3, max_size=3).map(torch.tensor)
FREE = st.lists(st.lists(st.booleans(), min_size=SIZE, max_size=SIZE), min_size=3, max_size=3).map(torch.tensor)
STEPS = st.integers(1, 12)


@given(SEEDS, FREE, STEPS)
def test_a_plan_samples_every_free_position_once(seeds, free, steps):
    plan = plan_unmasking(uniform(seeds, 0, SIZE), free, cosine_counts(free.sum(1), steps))
    assert torch.equal(sum((step.sampled.long() for step in plan), torch.zeros(3, SIZE, dtype=torch.long)), free.long())
    for step in plan:
        assert not (step.sampled & ~step.masked).any()


@given(SEEDS, FREE, STEPS)
def test_walking_through_a_plan_writes_the_free_positions_only(seeds, free, steps):
    plan = plan_unmasking(uniform(seeds, 0, SIZE), free, cosine_counts(free.sum(1), steps))
    state, masked = torch.zeros(3, SIZE, 2), torch.full((2,), 9.0)
    for _, after in unmask(state, masked, plan, lambda step, latents, where: torch.ones(len(where[0]), 2)):
        state = after
    assert torch.equal(state, free[..., None].expand(-1, -1, 2).float())


@given(SEEDS, FREE, STEPS, st.booleans())
def test_tokens_once_decoded_stay(seeds, free, steps, ordered):
    table = torch.randn(3, SIZE, CLASSES, generator=torch.Generator().manual_seed(0))
    before, seen = torch.full((3, SIZE), -1), free
    order = uniform(seeds, 1, SIZE) if ordered else None
    counts = cosine_counts(free.sum(1), steps)
    logits = lambda codes, masked, step: table.roll(step, 1)  # noqa: E731
    for masked, after in unmask_tokens(before, free, counts, logits, choice(SeededDraws(seeds)), order):
        assert not (masked & ~seen).any()
        assert torch.equal(after[~masked], before[~masked])
        before, seen = after, masked
    assert torch.equal(before >= 0, free)


@given(SEEDS, st.integers(0, 40), st.integers(1, 30), st.integers(0, 30))
def test_numbers_do_not_depend_on_how_many_are_drawn(seeds, step, size, more):
    numbers = uniform(seeds, step, size + more)
    assert torch.equal(numbers[:, :size], uniform(seeds, step, size))
    assert ((numbers > 0) & (numbers < 1)).all()


@given(SEEDS, st.lists(st.sets(st.integers(0, CLASSES - 1), max_size=CLASSES - 1), min_size=3, max_size=3))
def test_excluded_classes_are_never_drawn(seeds, excluded):
    logits = torch.zeros(3, 40, CLASSES)
    for row, classes in zip(logits, excluded, strict=True):
        row[:, list(classes)] = -torch.inf
    picked = SeededDraws(seeds).pick(0, logits)
    assert all(not classes & set(row.tolist()) for row, classes in zip(picked, excluded, strict=True))

"""Test BAD's hybrid masks against their definition, written out rule by rule, for every small case there is."""

from __future__ import annotations

from itertools import permutations, product

import pytest
import torch

from kinema.masking import hybrid_mask, official_inference_mask

DIRECTIONS = {"ge": lambda other, own: other >= own, "le": lambda other, own: other <= own}


def by_the_rules(orders, masked, length, *, conditions, direction, unmasked_see_masks) -> list[list[bool]]:
    """Apply BAD §3.6 to one sample, row by row and column by column; position k is [sentence, time?, tokens]."""
    size = conditions + len(orders)

    def is_masked(k: int) -> bool:
        return k >= conditions and masked[k - conditions]

    def valid(k: int) -> bool:
        return k < conditions or k - conditions <= length

    def allowed(q: int, k: int) -> bool:
        if not valid(k):
            return False
        if k < conditions:
            return True
        if q == 0:
            return unmasked_see_masks or not is_masked(k)
        if q < conditions:
            return True
        if not is_masked(q):
            return unmasked_see_masks or not is_masked(k)
        return not is_masked(k) or DIRECTIONS[direction](orders[k - conditions], orders[q - conditions])

    return [[allowed(q, k) for k in range(size)] for q in range(size)]


def cases(slots: int):
    """Give every length below `slots`, every permutation of its positions and every set of masked ones."""
    for length in range(1, slots):
        for order in permutations(range(length)):
            for masked in product((False, True), repeat=length):
                rest = slots - length
                yield (*order, *range(90, 90 + rest)), (*masked, *[False] * rest), length


@pytest.mark.parametrize("conditions", [1, 2])
@pytest.mark.parametrize("unmasked_see_masks", [False, True])
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_every_small_case(direction, unmasked_see_masks, conditions):
    """Go through up to five positions, with END and as much padding as there is room for in six slots."""
    rules = {"conditions": conditions, "direction": direction, "unmasked_see_masks": unmasked_see_masks}
    for slots in range(2, 7):
        listed = list(cases(slots))
        orders, masked, lengths = (torch.tensor(column) for column in zip(*listed, strict=True))
        expected = torch.tensor([by_the_rules(*case, **rules) for case in listed])
        assert torch.equal(hybrid_mask(orders, masked, lengths, **rules), expected)


EXAMPLE = """
    1 1 1 1 0 0 1 0
    1 1 1 1 1 1 1 0
    1 1 1 1 0 0 1 0
    1 1 1 1 0 0 1 0
    1 1 1 1 1 0 1 0
    1 1 1 1 1 1 1 0
    1 1 1 1 0 0 1 0
    1 1 1 1 0 0 1 0
"""
"""BAD §3: rows and columns are sentence, time, p0..p3, END, PAD; orders 0, 1, 3, 2; p2 and p3 are masked."""


def test_worked_example():
    orders = torch.tensor([[0, 1, 3, 2, 4, 5]])
    masked = torch.tensor([[False, False, True, True, False, False]])
    expected = torch.tensor([[int(v) for v in line.split()] for line in EXAMPLE.split("\n") if line.strip()]).bool()
    assert torch.equal(hybrid_mask(orders, masked, torch.tensor([4]), conditions=2)[0], expected)


def official(orders, free, masked, length, *, conditions, direction, unmasked_see_masks) -> list[list[bool]]:
    """Apply BAD §4 to one sample: the mask of the start, decoded columns for all rows, and column length + 1."""
    rules = {"conditions": conditions, "direction": direction, "unmasked_see_masks": unmasked_see_masks}
    rows = by_the_rules(orders, free, length, **rules)
    decoded = [conditions + j for j in range(len(orders)) if free[j] and not masked[j]]
    for row in rows:
        for column in (*decoded, length + 1):
            row[column] = True
    return rows


@pytest.mark.parametrize("conditions", [1, 2])
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_published_inference_mask(direction, conditions):
    """Go through every set of decoded and given tokens of four slots (three where a token is END)."""
    listed = [
        (order, free, tuple(f and m for f, m in zip(free, masked, strict=True)), length)
        for order, free, length in cases(4)
        for masked in product((False, True), repeat=4)
    ]
    rules = {"conditions": conditions, "direction": direction, "unmasked_see_masks": False}
    columns = (torch.tensor(column) for column in zip(*listed, strict=True))
    expected = torch.tensor([official(*case, **rules) for case in listed])
    assert torch.equal(official_inference_mask(*columns, **rules), expected)


def test_published_inference_mask_equals_ours_while_everything_is_masked():
    """Show the difference at its smallest: the last token is seen by all, where END was meant."""
    orders, free, lengths = torch.tensor([[2, 0, 1, 3]]), torch.tensor([[True, True, True, False]]), torch.tensor([3])
    ours = hybrid_mask(orders, free, lengths, conditions=2)
    published = official_inference_mask(orders, free, free, lengths, conditions=2)
    differs = ours != published
    assert differs.any(dim=1)[0].nonzero().flatten().tolist() == [2 + 2]
    assert published[0, :, 2 + 2].all()
    without_time = [
        f(orders, *m, lengths, conditions=1)
        for f, m in ((hybrid_mask, [free]), (official_inference_mask, [free, free]))
    ]
    assert torch.equal(*without_time)


def test_an_unknown_direction_is_named():
    orders = torch.zeros(1, 2, dtype=torch.long)
    with pytest.raises(ValueError, match="direction 'gt' is unknown; choose one of ge, le"):
        hybrid_mask(orders, orders.bool(), torch.tensor([1]), conditions=1, direction="gt")

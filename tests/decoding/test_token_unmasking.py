"""Test the unmasking loop over tokens: what is masked when, what is kept, which order, and how codes are chosen."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from kinema.decoding import token_unmasking
from kinema.decoding.draws import Greedy, SeededDraws
from kinema.decoding.token_unmasking import choice, unmask_tokens
from kinema.masking import shrinking_counts
from kinema.types import frame_mask

LENGTHS = torch.tensor([49, 24, 11, 7, 2, 1])
SEEDS = torch.arange(6)
CLASSES = 13


def start(share: float = 1.0) -> tuple[Tensor, Tensor]:
    """Give codes and which positions are free: about this share of the real ones."""
    generator = torch.Generator().manual_seed(0)
    codes = torch.randint(CLASSES, (6, 49), generator=generator)
    return codes, frame_mask(LENGTHS, 49) & (torch.rand(6, 49, generator=generator) <= share)


def predict(codes: Tensor, masked: Tensor, step: int) -> Tensor:
    """Give logits that depend on every visible code of the sample, on the position and on the step."""
    table = torch.randn(49, CLASSES, generator=torch.Generator().manual_seed(step))
    context = (codes.masked_fill(masked, 0) * torch.arange(1, 50)).sum(dim=1) % 97
    return 3 * torch.sin(table * (1 + context[:, None, None]))


def run(free: Tensor, codes: Tensor, order: Tensor | None = None, **options):
    counts = shrinking_counts(LENGTHS, 10, free=free.sum(dim=1))
    choose = options.get("choose", choice(SeededDraws(SEEDS)))
    return list(unmask_tokens(codes, free, counts, options.get("predict", predict), choose, order)), counts


@pytest.mark.parametrize("ordered", [False, True])
@pytest.mark.parametrize("share", [1.0, 0.4, 0.0])
def test_every_free_position_is_decoded_once_for_good(share, ordered):
    """Follow the masks: all free positions at first, then fewer and fewer of them; unmasked codes never change."""
    codes, free = start(share)
    states, counts = run(free, codes, SeededDraws(SEEDS).order(49) if ordered else None)
    seen, before = free, codes
    for step, (masked, after) in enumerate(states):
        assert torch.equal(masked, free) if step == 0 else not (masked & ~seen).any()
        assert torch.equal(masked.sum(dim=1), counts[step].minimum(free.sum(dim=1)))
        assert torch.equal(after[~masked], before[~masked])
        seen, before = masked, after
    assert len(states) == 10
    assert torch.equal(before[~free], codes[~free])


def test_what_masked_positions_held_means_nothing():
    codes, free = start(0.6)
    changed = torch.where(free, (codes + 5) % CLASSES, codes)
    results = [run(free, given)[0][-1][1] for given in (codes, changed)]
    assert torch.equal(*results)


def test_the_least_confident_are_masked_again():
    codes, free = start()
    logits = []

    def watched(codes: Tensor, masked: Tensor, step: int) -> Tensor:
        logits.append(predict(codes, masked, step))
        return logits[-1]

    states, _ = run(free, codes, predict=watched)
    for (before, after), (masked, _), seen in zip(states, states[1:], logits, strict=False):
        confidence = seen.softmax(-1).gather(-1, after[..., None])[..., 0]
        least_kept = confidence.masked_fill(~before | masked, torch.inf).amin(dim=1)
        assert (confidence.masked_fill(~masked, -torch.inf).amax(dim=1) <= least_kept).all()


def test_an_order_decides_alone():
    codes, free = start()
    order = torch.arange(49.0).expand(6, -1)
    states, counts = run(free, codes, order)
    for count, (masked, _) in zip(counts, states, strict=True):
        kept = LENGTHS - count
        assert torch.equal(masked, free & (torch.arange(49) >= kept[:, None]))


def test_samples_do_not_depend_on_batch_order_or_padding():
    codes, free = start(0.7)
    rows = torch.tensor([3, 1])
    counts = shrinking_counts(LENGTHS[rows], 10, free=free[rows].sum(dim=1))

    def narrow(codes: Tensor, masked: Tensor, step: int) -> Tensor:
        pad = torch.nn.functional.pad
        return predict(pad(codes, (0, 25)), pad(masked, (0, 25), value=True), step)[:, :24]

    def padded_with_zeros(codes: Tensor, masked: Tensor, step: int) -> Tensor:
        return predict(codes.masked_fill(~frame_mask(LENGTHS, 49), 0), masked, step)

    together = run(free, codes, predict=padded_with_zeros)[0][-1][1]
    some = codes[rows, :24].masked_fill(~frame_mask(LENGTHS[rows], 24), 0)
    *_, (_, alone) = unmask_tokens(some, free[rows, :24], counts, narrow, choice(SeededDraws(SEEDS[rows])))
    for i, row in enumerate(rows):
        assert torch.equal(alone[i, : LENGTHS[row]], together[row, : LENGTHS[row]])


def test_temperature():
    logits = predict(*start(), 0)
    draws = SeededDraws(SEEDS)
    assert torch.equal(choice(draws, 0.0)(0, logits), logits.argmax(-1))
    assert torch.equal(choice(Greedy(SEEDS))(0, logits), logits.argmax(-1))
    assert torch.equal(choice(draws)(0, logits), draws.pick(0, logits))
    assert torch.equal(choice(draws, 0.5)(0, logits), draws.pick(0, logits * 2))


def test_parts_change_nothing(monkeypatch):
    codes, free = start()
    whole = run(free, codes)[0][-1][1]
    monkeypatch.setattr(token_unmasking, "PART", 49 * CLASSES * 2)
    assert torch.equal(run(free, codes)[0][-1][1], whole)


@pytest.mark.parametrize("steps", [1, 3, 10, 18])
def test_counts_shrink_from_all_to_one(steps):
    lengths = torch.arange(1, 50)
    free = lengths // 2
    for counts, first in (
        (shrinking_counts(lengths, steps), lengths),
        (shrinking_counts(lengths, steps, free=free), free.clamp(min=1)),
    ):
        assert torch.equal(counts[0], first)
        assert (counts.diff(dim=0) <= 0).all()
        assert (counts >= 1).all()

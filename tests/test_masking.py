"""Test mask counts and choices."""

from __future__ import annotations

import torch

from kinema.masking import cosine_counts, lowest, masked_count, ranks


def test_counts_of_49_latents_in_18_steps():
    """Compare with MARDM §6."""
    expected = [49, 49, 48, 47, 46, 44, 42, 39, 36, 33, 30, 26, 22, 18, 13, 9, 5, 1]
    assert cosine_counts(torch.tensor([49]), 18)[:, 0].tolist() == expected


def test_one_step_masks_everything():
    assert cosine_counts(torch.tensor([49, 3]), 1).tolist() == [[49, 3]]


def test_counts_round_half_to_even_and_never_to_nothing():
    assert masked_count(torch.tensor([5, 7, 1]), torch.tensor([0.5, 0.5, 0.1])).tolist() == [2, 4, 1]


def test_ranks():
    assert ranks(torch.tensor([[0.3, 0.1, 0.2]])).tolist() == [[2, 0, 1]]


def test_lowest_never_takes_what_is_not_eligible():
    scores = torch.tensor([[0.0, 0.1, 0.2, 0.3]] * 2)
    eligible = torch.tensor([[False, True, True, True], [False, False, True, False]])
    chosen = lowest(scores, eligible, torch.tensor([2, 3]))
    assert chosen.tolist() == [[False, True, True, False], [False, False, True, False]]

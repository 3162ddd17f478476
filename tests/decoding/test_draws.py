"""Test the counter-based draws: distribution, independence of batch and size, filtered classes."""

from __future__ import annotations

import pytest
import torch

from kinema.decoding.draws import SeededDraws, categorical, uniform


def test_numbers_are_uniform_and_uncorrelated():
    u = uniform(torch.arange(400), 3, 500)
    assert u.min() > 0
    assert u.max() < 1
    histogram = torch.histc(u, 20, 0, 1) / u.numel()
    assert (histogram - 0.05).abs().max() < 0.002
    for a, b in ((u[:, :-1], u[:, 1:]), (u[:-1], u[1:]), (u, uniform(torch.arange(400), 4, 500))):
        assert torch.corrcoef(torch.stack((a.flatten(), b.flatten())))[0, 1].abs() < 0.01


def test_a_sample_does_not_depend_on_batch_or_size():
    seeds = torch.tensor([5, 7, 2**62])
    assert torch.equal(uniform(seeds, 0, 49)[1:, :20], uniform(seeds[1:], 0, 20))
    logits = torch.randn(3, 9, 30, generator=torch.Generator().manual_seed(0))
    picked = SeededDraws(seeds).pick(4, logits)
    assert torch.equal(picked[2:, :5], SeededDraws(seeds[2:]).pick(4, logits[2:, :5]))
    assert not torch.equal(picked, SeededDraws(seeds, stream=2).pick(4, logits))


def test_categorical_follows_the_distribution():
    logits = torch.tensor([0.0, -torch.inf, 1.0, 2.0, -torch.inf])
    drawn = categorical(logits.expand(1, 40_000, 5), uniform(torch.tensor([1]), 0, 40_000))
    share = torch.bincount(drawn[0], minlength=5) / 40_000
    assert (share - logits.softmax(-1)).abs().max() < 0.01
    assert share[1] == share[4] == 0


def test_the_ends_of_the_distribution_are_never_filtered_classes():
    logits = torch.tensor([-torch.inf, 0.3, -torch.inf])
    ends = torch.tensor([2.0**-25, 1 - 2.0**-22])
    assert categorical(logits.expand(2, 3), ends).tolist() == [1, 1]


def test_a_seeds_draws_stay_what_they_are():
    """Motions of a manifest, and rows of a table, come again in later versions."""
    drawn = [0.4237121045589447, 0.9697024822235107, 0.9858198165893555]
    assert uniform(torch.tensor([5]), 0, 3)[0].tolist() == pytest.approx(drawn, abs=1e-7)
    order = SeededDraws(torch.tensor([5]), 2).order(2)[0].tolist()
    assert order == pytest.approx([0.06517031788825989, 0.30394837260246277], abs=1e-7)

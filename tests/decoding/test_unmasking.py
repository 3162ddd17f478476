"""Test the random-order unmasking plan, its loop and the draws per sample."""

from __future__ import annotations

from itertools import islice, pairwise

import pytest
import torch

from kinema.decoding.unmasking import SampleDraws, plan_unmasking, unmask
from kinema.masking import cosine_counts
from kinema.types import frame_mask

LENGTHS = torch.tensor([49, 10, 1])


@pytest.fixture
def order():
    return torch.rand(3, 49, generator=torch.Generator().manual_seed(0))


def make_plan(order, **options):
    return plan_unmasking(order, frame_mask(LENGTHS, 49), cosine_counts(LENGTHS, 18), **options)


def test_every_position_is_sampled_once(order):
    sampled = torch.stack([step.sampled for step in make_plan(order)]).sum(dim=0)
    assert torch.equal(sampled, frame_mask(LENGTHS, 49).long())


def test_published_plan_samples_557_rows_of_49(order):
    published = torch.stack([step.sampled for step in make_plan(order, resample_all=True)])
    assert published.sum(dim=(0, 2))[:2].tolist() == [557, 115]
    assert len(published) == 18
    assert len(make_plan(order)) < 18


def test_highest_order_is_decoded_first(order):
    decoded = [order[0][step.sampled[0]] for step in make_plan(order)]
    for earlier, later in pairwise(decoded):
        assert not len(earlier) or not len(later) or earlier.min() > later.max()


def test_masked_positions_are_hidden_and_the_rest_is_kept(order):
    start = torch.randn(3, 49, 4)
    mask_latent = torch.full((4,), 99.0)
    seen = []

    def predict(step, latents, where):
        seen.append((step, latents.clone()))
        return torch.full((len(where[0]), 4), float(step.index))

    *_, (_, final) = unmask(start, mask_latent, make_plan(order), predict)
    for step, latents in seen:
        assert (latents[step.masked] == 99).all()
        assert torch.equal((latents == 99).all(dim=2), step.masked)
    for step, _ in seen:
        assert (final[step.sampled] == step.index).all()
    assert torch.equal(final[~frame_mask(LENGTHS, 49)], start[~frame_mask(LENGTHS, 49)])


def test_draws_depend_on_the_own_seed_only():
    """Draw a sample's order and noise alone and among others."""
    masks = frame_mask(torch.tensor([3, 2, 4]), 9)

    def draw(rows: list[int]):
        seeds, lengths = torch.tensor([5, 6, 7])[rows], torch.tensor([9, 5, 4])[rows]
        draws = SampleDraws(seeds, lengths, width=2)
        order = draws.order()
        noise = [torch.stack(list(islice(draws.noise(i, masks[rows]), 12))) for i in range(2)]
        return order, noise

    order, noise = draw([0, 1, 2])
    alone, noise_alone = draw([1])
    assert torch.equal(order[1, :5], alone[0, :5])
    assert (order[1, 5:] == 2).all()
    for together, single in zip(noise, noise_alone, strict=True):
        assert torch.equal(together[:, 3:5], single)
    assert not torch.equal(noise[0], noise[1])

"""Test the length estimator."""

from __future__ import annotations

import pytest
import torch

from kinema.generators.length import LengthEstimator
from kinema.types import Latents, TextFeatures

TEXT = TextFeatures(["a"] * 64, torch.randn(64, 5, generator=torch.Generator().manual_seed(0)))
SEEDS = torch.arange(64)


@pytest.fixture
def estimator():
    torch.manual_seed(0)
    return LengthEstimator(text_dim=5, classes=10).eval()


def test_predictions_are_whole_latents_and_never_none(estimator):
    torch.nn.init.zeros_(estimator.layers[-1].weight)
    with torch.no_grad():
        estimator.layers[-1].bias.copy_(torch.tensor([100.0] + [0.0] * 9))
    frames = estimator.predict(TEXT, SEEDS)
    assert set(frames.tolist()) == set(range(4, 40, 4))


def test_a_prediction_depends_on_its_own_seed_only(estimator):
    frames = estimator.predict(TEXT, SEEDS)
    order = torch.arange(63, -1, -1)[:10]
    some = TextFeatures(["a"] * 10, TEXT.pooled[order])
    assert torch.equal(estimator.predict(some, SEEDS[order]), frames[order])


def test_predictions_follow_the_distribution(estimator):
    torch.nn.init.zeros_(estimator.layers[-1].weight)
    with torch.no_grad():
        estimator.layers[-1].bias.copy_(torch.tensor([0.0, 0.6, 0.4, *[1e-30] * 7]).log().clamp(min=-50))
    many = TextFeatures(["a"] * 2000, torch.zeros(2000, 5))
    share = (estimator.predict(many, torch.arange(2000)) == 4).float().mean().item()
    assert share == pytest.approx(0.6, abs=0.04)


def test_it_learns_the_lengths():
    torch.manual_seed(0)
    estimator = LengthEstimator(text_dim=5, classes=10, dropout=0.0)
    lengths = torch.arange(64) % 9 + 1
    text = TextFeatures(["a"] * 64, torch.nn.functional.one_hot(lengths // 2, 5).float())
    latents = Latents(lengths=lengths, frames=lengths * 4)
    optimizer = torch.optim.Adam(estimator.parameters(), lr=1e-3)
    losses = []
    for _ in range(40):
        loss = estimator.loss(latents, text)["loss"]
        losses.append(loss.item())
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    assert losses[-1] < 0.5 * losses[0]


def test_bad_input_is_named(estimator):
    ten = torch.full((64,), 10)
    with pytest.raises(ValueError, match="10 latents exceeds the 9"):
        estimator.loss(Latents(lengths=ten, frames=ten * 4), TEXT)
    with pytest.raises(ValueError, match="64 texts but 3 seeds"):
        estimator.predict(TEXT, SEEDS[:3])

"""Test that whole sequences are sampled by their own seeds, whatever their batch and padding."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from kinema.diffusion.ddpm import DDPM, SOLVERS
from kinema.diffusion.flow import Flow
from kinema.diffusion.noise import sequence_noise
from kinema.types import frame_mask

SEEDS, LENGTHS, WIDTH = torch.tensor([7, 3, 2**40]), torch.tensor([4, 9, 6]), 5
CHOICES = [(DDPM(prediction="x0"), solver) for solver in SOLVERS] + [(Flow(), solver) for solver in ("heun", "sde")]


def sample(process: DDPM | Flow, solver: str, chosen: list[int]) -> list[Tensor]:
    """Sample some of the sequences together, by a network that mixes the real frames of each."""
    lengths = LENGTHS[chosen]
    mask = frame_mask(lengths, int(lengths.max()))[:, :, None]

    def predict(x: Tensor, t: Tensor) -> Tensor:
        return torch.tanh(x + (x * mask).sum(dim=1, keepdim=True) / mask.sum(dim=1, keepdim=True)) + t / 100

    noise = sequence_noise(SEEDS[chosen], lengths, WIDTH)
    result = process.sample(predict, noise, solver=solver, steps=6)
    return [row[:length] for row, length in zip(result, lengths.tolist(), strict=True)]


@pytest.mark.parametrize(("process", "solver"), CHOICES)
def test_samples_do_not_depend_on_batch_order_or_padding(process, solver):
    together = sample(process, solver, [0, 1, 2])
    shuffled = sample(process, solver, [2, 0, 1])
    for chosen, row in zip([2, 0, 1], shuffled, strict=True):
        torch.testing.assert_close(row, together[chosen])
        torch.testing.assert_close(sample(process, solver, [chosen])[0], together[chosen])


def test_each_draw_is_new_normal_and_padded_with_zeros():
    noise = sequence_noise(torch.tensor([1, 2, 1]), torch.tensor([300, 200, 300]), 40)
    draws = torch.stack([next(noise) for _ in range(3)])
    assert torch.equal(draws[:, 0], draws[:, 2])
    assert not draws[:, 1, 200:].any()
    real = torch.stack([*draws[:, 0, :200], *draws[:, 1, :200]]).flatten(1)
    torch.testing.assert_close(torch.corrcoef(real), torch.eye(6), rtol=0, atol=0.05)
    torch.testing.assert_close(real.mean(dim=1), torch.zeros(6), rtol=0, atol=0.05)
    torch.testing.assert_close(real.std(dim=1), torch.ones(6), rtol=0, atol=0.05)

"""Test DDPM on Gaussian data, whose optimal denoiser has a closed form."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch
from torch import Tensor

from kinema.diffusion.ddpm import DDPM

MEAN, STD = 0.7, 0.5


def denoiser(process: DDPM):
    """Make the best possible prediction for data N(MEAN, STD^2)."""

    def predict(x: Tensor, t: Tensor) -> Tensor:
        alpha_bar = process.schedule.alphas_cumprod[t.long()].float()
        variance = alpha_bar * STD**2 + 1 - alpha_bar
        noise = (1 - alpha_bar).sqrt() * (x - alpha_bar.sqrt() * MEAN) / variance
        clean = (x - (1 - alpha_bar).sqrt() * noise) / alpha_bar.sqrt()
        return noise if process.prediction == "epsilon" else clean

    return predict


def noises(*shape: int, seed: int = 0) -> Iterator[Tensor]:
    generator = torch.Generator().manual_seed(seed)
    while True:
        yield torch.randn(shape, generator=generator)


@pytest.mark.parametrize("solver", ["ancestral", "ddim"])
@pytest.mark.parametrize("prediction", ["epsilon", "x0"])
def test_samples_have_the_data_distribution(solver, prediction):
    process = DDPM(steps=400, prediction=prediction)
    samples = process.sample(denoiser(process), noises(20000, 1), solver=solver)
    assert samples.mean().item() == pytest.approx(MEAN, abs=0.02)
    assert samples.std().item() == pytest.approx(STD, abs=0.02)


@pytest.mark.parametrize("steps", [1, 2, 10, "20,10"])
def test_respaced_sampling_ends_near_the_data(steps):
    process = DDPM()
    samples = process.sample(denoiser(process), noises(5000, 1), steps=steps)
    assert samples.mean().item() == pytest.approx(MEAN, abs=0.1)
    assert samples.std().item() < 1.2 * STD


def test_noise_is_drawn_once_per_step_but_the_last():
    drawn = []

    def counted() -> Iterator[Tensor]:
        for noise in noises(2, 3):
            drawn.append(noise)
            yield noise

    DDPM(steps=7).sample(lambda x, t: x, counted())
    assert len(drawn) == 7
    drawn.clear()
    DDPM(steps=7).sample(lambda x, t: x, counted(), solver="ddim")
    assert len(drawn) == 1


def test_an_untrained_model_diverges_unless_clipped():
    """Show why an undertrained model is clipped: the first step multiplies the epsilon error by 32."""
    process, limits = DDPM(), (torch.tensor([-3.0, -1.0]), torch.tensor([3.0, 1.0]))
    free = process.sample(lambda x, t: torch.zeros_like(x), noises(200, 2))
    clipped = process.sample(lambda x, t: torch.zeros_like(x), noises(200, 2), clip=limits)
    assert free.abs().max() > 100
    assert (clipped >= limits[0]).all()
    assert (clipped <= limits[1]).all()


def test_loss_is_the_noise_error_per_row():
    process = DDPM()
    x1, noise, t = torch.randn(4, 3, 2), torch.randn(4, 3, 2), torch.tensor([0, 10, 30, 49])
    assert not process.loss(lambda x, t: noise, x1, t, noise).any()
    loss = process.loss(lambda x, t: torch.zeros_like(x), x1, t, noise)
    torch.testing.assert_close(loss, noise.square().mean(dim=(1, 2)))


def test_temperature_scales_the_step_noise():
    process = DDPM()
    spread = [
        process.sample(denoiser(process), noises(2000, 1), temperature=temperature).std()
        for temperature in (0.0, 0.5, 1.0)
    ]
    assert spread[0] < spread[1] < spread[2]


def test_bad_choices_are_named():
    process = DDPM()
    with pytest.raises(ValueError, match="solver 'euler' is unknown to DDPM; choose one of ancestral, ddim"):
        process.sample(lambda x, t: x, noises(1, 1), solver="euler")
    with pytest.raises(ValueError, match=r"temperature 0\.5 has no effect on 'ddim'"):
        process.sample(lambda x, t: x, noises(1, 1), solver="ddim", temperature=0.5)
    with pytest.raises(ValueError, match="prediction 'v' is unknown; choose one of epsilon, x0"):
        DDPM(prediction="v")


def test_tables_are_not_saved():
    assert not DDPM().state_dict()

"""Test DDPM on Gaussian data, whose optimal denoiser has a closed form."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch
from torch import Tensor

from kinema.diffusion.ddpm import DDPM, SOLVERS
from kinema.diffusion.denoising import ODE_SOLVERS
from kinema.diffusion.guidance import Guidance, guided
from kinema.diffusion.predictions import PREDICTIONS

MEAN, STD = 0.7, 0.5


def denoiser(process: DDPM):
    """Make the best possible prediction for data N(MEAN, STD^2)."""

    def predict(x: Tensor, t: Tensor) -> Tensor:
        alpha_bar = process.schedule.alphas_cumprod[t.long()].float()
        variance = alpha_bar * STD**2 + 1 - alpha_bar
        noise = (1 - alpha_bar).sqrt() * (x - alpha_bar.sqrt() * MEAN) / variance
        clean = (x - (1 - alpha_bar).sqrt() * noise) / alpha_bar.sqrt()
        velocity = alpha_bar.sqrt() * noise - (1 - alpha_bar).sqrt() * clean
        return {"epsilon": noise, "x0": clean, "velocity": velocity}[process.prediction]

    return predict


def noises(*shape: int, seed: int = 0) -> Iterator[Tensor]:
    generator = torch.Generator().manual_seed(seed)
    while True:
        yield torch.randn(shape, generator=generator)


@pytest.mark.filterwarnings("ignore:.*multiplies the error of epsilon")
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("prediction", PREDICTIONS)
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
    DDPM(steps=7).sample(lambda x, t: x, counted(), solver="ddim", steps=5)
    assert len(drawn) == 1


def test_an_untrained_model_diverges_unless_clipped():
    """Show why an undertrained model is clipped: the first step multiplies the epsilon error by 32."""
    process, limits = DDPM(), (torch.tensor([-3.0, -1.0]), torch.tensor([3.0, 1.0]))
    free = process.sample(lambda x, t: torch.zeros_like(x), noises(200, 2))
    clipped = process.sample(lambda x, t: torch.zeros_like(x), noises(200, 2), clip=limits)
    assert free.abs().max() > 100
    assert (clipped >= limits[0]).all()
    assert (clipped <= limits[1]).all()


@pytest.mark.parametrize("solver", ODE_SOLVERS)
def test_a_count_of_ode_steps_starts_where_an_error_of_epsilon_stays_small(solver):
    """Measure by how much an error of 0.03 moves the samples of a perfect model."""
    process = DDPM()
    perfect = denoiser(process)

    def moved(steps: int | str | None) -> float:
        samples = [
            process.sample(lambda x, t, e=error: perfect(x, t) + e, noises(9, 1), solver=solver, steps=steps)
            for error in (0.0, 0.03)
        ]
        return ((samples[1] - samples[0]).abs().max() / STD).item()

    assert moved(16) < 0.15
    assert moved(48) < 0.15
    for steps in (None, "8,8"):
        with pytest.warns(UserWarning, match=f"'{solver}' starts at timestep 49, which multiplies .* by 1015"):
            assert moved(steps) > 0.4


@pytest.mark.filterwarnings("error")
def test_published_samplers_are_taken_as_they_are():
    """MLD's DDIM starts from timestep 981; the noisiest time is no trouble for models of x0 or velocity."""
    _, leading = DDPM(1000, "scaled_linear").resolve("ddim", "leading50")
    assert leading.timesteps[-1] == 981
    for prediction in ("x0", "velocity"):
        for steps in (50, "15,15,8,6,6", None):
            assert DDPM(1000, prediction=prediction).resolve("ddim", steps)[1].timesteps[-1] == 999
    assert DDPM().resolve("ancestral", 16)[1].timesteps[-1] == 49


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("prediction", PREDICTIONS)
def test_known_values_come_out_and_lead_the_others(solver, prediction):
    """Hold one of two equal features: the model reads the first, so the second follows."""
    process = DDPM(200, prediction=prediction)
    values, mask = torch.tensor([[2.0, 0.0]]).repeat(50, 1), torch.tensor([[True, False]]).repeat(50, 1)

    def predict(x: Tensor, t: Tensor) -> Tensor:
        signal, sigma = process.signal[t.long()], process.noise[t.long()]
        clean = x[:, :1] * signal / (signal**2 + sigma**2) + torch.zeros_like(x)
        noise = (x - signal * clean) / sigma
        return {"epsilon": noise, "x0": clean, "velocity": signal * noise - sigma * clean}[prediction]

    samples = process.sample(predict, noises(50, 2), solver=solver, steps=100, known=(values, mask))
    torch.testing.assert_close(samples[:, 0], torch.full((50,), 2.0), rtol=0, atol=1e-3)
    torch.testing.assert_close(samples[:, 1], torch.full((50,), 2.0), rtol=0, atol=0.1)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("guidance", [Guidance(3.0), Guidance(3.0, (0.2, 0.7)), Guidance(3.0, growing=True)])
def test_guidance_on_epsilon_x0_or_velocity_is_the_same(solver, guidance):
    """Draw from one Gaussian, the empty condition being another."""
    samples = []
    for prediction in PREDICTIONS:
        process = DDPM(100, "scaled_linear", prediction=prediction)
        predict = denoiser(process)

        def shifted(x: Tensor, t: Tensor, condition: Tensor, predict=predict, process=process) -> Tensor:
            shift = condition * process.signal[t.long()]
            result = predict(x - shift, t)
            return {
                "epsilon": result,
                "x0": result + condition,
                "velocity": result - process.noise[t.long()] * condition,
            }[process.prediction]

        condition = torch.ones(200, 1)
        model = guided(shifted, condition, torch.zeros_like(condition), guidance.along(process.progress))
        samples.append(process.sample(model, noises(200, 1), solver=solver, steps="20,5,5"))
    torch.testing.assert_close(samples[0], samples[1], rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(samples[0], samples[2], rtol=1e-4, atol=1e-4)


def test_loss_is_the_noise_error_per_row():
    process = DDPM()
    x1, noise, t = torch.randn(4, 3, 2), torch.randn(4, 3, 2), torch.tensor([0, 10, 30, 49])
    assert not process.loss(lambda x, t: noise, x1, t, noise).any()
    loss = process.loss(lambda x, t: torch.zeros_like(x), x1, t, noise)
    torch.testing.assert_close(loss, noise.square().mean(dim=(1, 2)))


@pytest.mark.parametrize("prediction", PREDICTIONS)
def test_a_target_predicted_exactly_gives_the_clean_data_back(prediction):
    process = DDPM(prediction=prediction)
    x1, noise, t = torch.randn(4, 3, 2), torch.randn(4, 3, 2), torch.tensor([0, 10, 30, 45])
    target = PREDICTIONS[prediction].target(x1, noise, process.signal[t, None, None], process.noise[t, None, None])
    assert not process.loss(lambda x, t: target, x1, t, noise).any()
    noisy = process.add_noise(x1, t, noise)
    for row in range(4):
        alpha_bar = process.schedule.alphas_cumprod[t[row]].item()
        clean = PREDICTIONS[prediction].clean(noisy[row], target[row], alpha_bar)
        torch.testing.assert_close(clean, x1[row], rtol=1e-4, atol=1e-4)


def test_temperature_scales_the_step_noise():
    process = DDPM()
    spread = [
        process.sample(denoiser(process), noises(2000, 1), temperature=temperature).std()
        for temperature in (0.0, 0.5, 1.0)
    ]
    assert spread[0] < spread[1] < spread[2]


def test_bad_choices_are_named():
    process = DDPM()
    with pytest.raises(
        ValueError, match="solver 'euler' is unknown to DDPM; choose one of ancestral, ddim, heun, dpmpp_2m"
    ):
        process.sample(lambda x, t: x, noises(1, 1), solver="euler")
    with pytest.raises(ValueError, match=r"temperature 0\.5 has no effect on 'ddim'"):
        process.sample(lambda x, t: x, noises(1, 1), solver="ddim", steps=10, temperature=0.5)
    with pytest.raises(ValueError, match="cannot take 49 steps out of 48"):
        process.sample(lambda x, t: x, noises(1, 1), solver="ddim", steps=49)
    with pytest.raises(ValueError, match=r"DDPM.prediction=v: must be one of epsilon, x0, velocity"):
        DDPM(prediction="v")


def test_tables_are_not_saved():
    assert not DDPM().state_dict()


def test_training_draws_every_time():
    times = DDPM(4).draw_times((1000,), torch.Generator().manual_seed(0), torch.device("cpu"))
    assert torch.bincount(times, minlength=4).tolist() == pytest.approx([250] * 4, abs=60)

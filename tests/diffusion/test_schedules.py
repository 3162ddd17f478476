"""Test noise schedules and their respacing without reference files."""

from __future__ import annotations

import pytest
import torch

from kinema.diffusion.schedules import make_schedule, spaced_timesteps


def test_check_values_of_the_cosine_schedule():
    """Compare with the values that MDM §3 gives."""
    schedule = make_schedule("cosine", 50)
    assert schedule.betas[0].item() == pytest.approx(1.7475e-3, rel=1e-4)
    assert schedule.alphas_cumprod[25].item() == pytest.approx(0.462707, rel=1e-5)
    assert schedule.alphas_cumprod[49].item() == pytest.approx(9.71e-7, rel=1e-3)


@pytest.mark.parametrize("steps", [1, 2, 7, 50, "20,5", "ddim25"])
def test_respacing_keeps_the_noise_levels(steps):
    schedule = make_schedule("cosine", 50)
    respaced = schedule.respace(steps)
    torch.testing.assert_close(respaced.alphas_cumprod, schedule.alphas_cumprod[respaced.timesteps])
    assert (respaced.timesteps.diff() > 0).all()


def test_all_steps_are_the_identity():
    schedule = make_schedule("linear", 25)
    torch.testing.assert_close(schedule.respace("25").betas, schedule.betas)


def test_one_step_starts_from_noise():
    assert spaced_timesteps(50, "1").tolist() == [49]


@pytest.mark.parametrize(
    "steps", [0, 51, -1, "ten", "", "26,5", "1.5", "ddim30", "ddim", "20,30,5", "leading50", "leading20", "leading1"]
)
def test_impossible_steps_are_named(steps):
    with pytest.raises(ValueError, match="out of 50; give a count from 1 to 50"):
        spaced_timesteps(50, steps)


def test_leading_steps_end_at_the_noise_of_timestep_0():
    schedule = make_schedule("scaled_linear", 1000)
    leading = schedule.respace("leading50")
    assert leading.timesteps.tolist() == list(range(1, 1000, 20))
    assert leading.alphas_cumprod_prev[0] == schedule.alphas_cumprod[0]
    torch.testing.assert_close(leading.alphas_cumprod, schedule.alphas_cumprod[leading.timesteps])


def test_check_values_of_the_scaled_linear_schedule():
    """Compare with the values that MLD §2 gives."""
    alphas_cumprod = make_schedule("scaled_linear", 1000).alphas_cumprod
    assert alphas_cumprod[[0, 500, 999]].tolist() == pytest.approx([0.99915, 0.27633, 0.00466], abs=5e-6)


@pytest.mark.parametrize("name", ["linear", "scaled_linear"])
def test_few_steps_end_at_about_the_noise_of_many(name):
    few, many = (make_schedule(name, steps).alphas_cumprod[-1].log().item() for steps in (100, 1000))
    assert few == pytest.approx(many, rel=0.1)


@pytest.mark.parametrize(
    ("name", "steps", "message"),
    [
        ("sine", 50, "'sine' is unknown; choose one of cosine, linear, scaled_linear"),
        ("linear", 20, "'linear' leaves no signal in 20 steps; give more than 20, or take 'cosine'"),
        ("cosine", 0, "at least 1 step, got 0"),
    ],
)
def test_impossible_schedules_are_named(name, steps, message):
    with pytest.raises(ValueError, match=message):
        make_schedule(name, steps)

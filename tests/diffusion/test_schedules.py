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
    schedule = make_schedule("linear", 20)
    torch.testing.assert_close(schedule.respace("20").betas, schedule.betas)


def test_one_step_starts_from_noise():
    assert spaced_timesteps(50, "1").tolist() == [49]


@pytest.mark.parametrize("steps", [0, 51, -1, "ten", "", "26,5", "1.5", "ddim30", "ddim", "20,30,5"])
def test_impossible_steps_are_named(steps):
    with pytest.raises(ValueError, match="out of 50; give a count from 1 to 50"):
        spaced_timesteps(50, steps)


def test_unknown_schedule():
    with pytest.raises(ValueError, match="'sine' is unknown; choose one of cosine, linear"):
        make_schedule("sine", 50)

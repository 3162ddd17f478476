"""Compare noise schedules, respacings and mask counts with the published ones."""

from __future__ import annotations

import pytest
import torch
from safetensors.torch import load_file

from kinema.diffusion.schedules import Schedule, make_schedule
from kinema.masking import cosine_counts, cosine_ratio

CASES = {
    "official_train": ("cosine", 50, None),
    "official_sample": ("cosine", 50, "50"),
    "linear50": ("linear", 50, None),
    "linear1000": ("linear", 1000, None),
    "cosine1000_respace_50": ("cosine", 1000, 50),
    "cosine50_respace_10": ("cosine", 50, "10"),
    "cosine50_respace_25": ("cosine", 50, 25),
    "cosine50_respace_20,5": ("cosine", 50, "20,5"),
    "cosine50_respace_ddim10": ("cosine", 50, "ddim10"),
}
ARRAYS = (
    "betas",
    "alphas_cumprod",
    "alphas_cumprod_prev",
    "posterior_variance",
    "posterior_log_variance_clipped",
    "posterior_mean_coef1",
    "posterior_mean_coef2",
)


@pytest.fixture(scope="module")
def golden(golden_file):
    return load_file(golden_file("mardm/mardm_schedules.safetensors"))


def make(name: str, steps: int, respacing: str | int | None) -> Schedule:
    schedule = make_schedule(name, steps)
    return schedule if respacing is None else schedule.respace(respacing)


@pytest.mark.parametrize("case", CASES)
def test_noise_schedule(golden, case):
    schedule = make(*CASES[case])
    assert torch.equal(schedule.timesteps, golden[f"{case}.timestep_map"])
    for array in ARRAYS:
        torch.testing.assert_close(getattr(schedule, array), golden[f"{case}.{array}"], rtol=1e-9, atol=1e-15)


def test_the_noise_that_training_adds(golden):
    from kinema.diffusion.ddpm import DDPM

    process = DDPM()
    torch.testing.assert_close(process.signal, golden["official_train.sqrt_alphas_cumprod"].float())
    torch.testing.assert_close(process.noise, golden["official_train.sqrt_one_minus_alphas_cumprod"].float())


@pytest.mark.parametrize("length", [1, 4, 10, 25, 49])
def test_mask_counts(golden, length):
    assert cosine_counts(torch.tensor([length]), 18)[:, 0].tolist() == golden[f"mask_count.18.l{length}"].tolist()


def test_mask_ratio(golden):
    torch.testing.assert_close(
        cosine_ratio(torch.linspace(0, 1, 50)), golden["cosine_mask_ratio_50"], rtol=0, atol=1e-7
    )

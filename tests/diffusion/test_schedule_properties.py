"""Test what must hold of noise schedules whatever their length and spacing are."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from kinema.diffusion.schedules import make_schedule, spaced_timesteps

CLOSE = {"rtol": 1e-9, "atol": 1e-12}
# Linear betas reach 1 at 20 steps.
SCHEDULES = st.one_of(
    st.builds(make_schedule, st.just("cosine"), st.integers(1, 120)),
    st.builds(make_schedule, st.just("linear"), st.integers(21, 120)),
)


@given(SCHEDULES)
def test_noise_grows_from_step_to_step(schedule):
    assert ((schedule.betas > 0) & (schedule.betas < 1)).all()
    assert ((schedule.alphas_cumprod > 0) & (schedule.alphas_cumprod < 1)).all()
    assert (schedule.alphas_cumprod.diff() < 0).all()


@given(SCHEDULES)
def test_the_posterior_leads_from_one_noise_level_to_the_one_before(schedule):
    """Draw x_t from q(x_t | x0), then x_{t-1} from the posterior: mean and variance are those of q(x_{t-1} | x0)."""
    now, before = schedule.alphas_cumprod, schedule.alphas_cumprod_prev
    mean = schedule.posterior_mean_coef1 + schedule.posterior_mean_coef2 * now.sqrt()
    torch.testing.assert_close(mean, before.sqrt(), **CLOSE)
    variance = schedule.posterior_mean_coef2.square() * (1 - now) + schedule.posterior_variance
    torch.testing.assert_close(variance, 1 - before, **CLOSE)


@given(SCHEDULES, st.data())
def test_respacing_keeps_the_noise_levels_of_the_times_it_keeps(schedule, data):
    count = data.draw(st.integers(1, len(schedule.betas)))
    respaced = schedule.respace(count)
    assert len(respaced.betas) == count
    assert respaced.timesteps[-1] == len(schedule.betas) - 1
    torch.testing.assert_close(respaced.alphas_cumprod, schedule.alphas_cumprod[respaced.timesteps], **CLOSE)


@given(st.lists(st.integers(1, 12), min_size=1, max_size=4), st.integers(0, 40))
def test_counts_per_section_are_kept_in_ascending_times(counts, spare):
    total = max(counts) * len(counts) + spare
    times = spaced_timesteps(total, ",".join(map(str, counts)))
    assert len(times) == sum(counts)
    assert (times.diff() > 0).all()
    assert times[0] >= 0
    assert times[-1] < total


@given(st.integers(1, 60), st.integers(1, 60))
def test_more_steps_than_there_are_cannot_be_taken(total, more):
    with pytest.raises(ValueError, match=f"out of {total}"):
        spaced_timesteps(total, total + more)

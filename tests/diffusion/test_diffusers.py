"""Compare schedules and solvers step by step with diffusers, whose tables are float32."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from kinema.diffusion.ddpm import DDPM
from kinema.diffusion.schedules import Schedule, make_schedule

diffusers = pytest.importorskip("diffusers")

NAMES = {"linear": "linear", "scaled_linear": "scaled_linear", "cosine": "squaredcos_cap_v2"}
RANGES = {"linear": (1e-4, 0.02), "scaled_linear": (0.00085, 0.012), "cosine": (1e-4, 0.02)}
PREDICTIONS = {"epsilon": "epsilon", "x0": "sample", "velocity": "v_prediction"}
pytestmark = [
    pytest.mark.filterwarnings("ignore:.*multiplies the error of epsilon"),
    pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning:diffusers.*"),
]


def scheduler(kind: str, schedule: str, prediction: str, **options):
    """Make a scheduler of diffusers over 1000 training steps."""
    start, end = RANGES[schedule]
    options |= {} if kind == "DPMSolverMultistepScheduler" else {"clip_sample": False}
    return getattr(diffusers, kind)(
        1000, start, end, NAMES[schedule], prediction_type=PREDICTIONS[prediction], **options
    )


def network(x: Tensor, t: Tensor) -> Tensor:
    """Stand for a network."""
    return torch.tanh(0.8 * x + torch.cos(t / 300)) + 0.1 * x.roll(1, dims=-1)


def reference(theirs, x: Tensor, **options) -> list[Tensor]:
    """Walk through their steps and keep every state."""
    states = []
    for t in theirs.timesteps:
        x = theirs.step(network(x, t.float()), t, x, **options).prev_sample
        states.append(x)
    return states


def states(process: DDPM, schedule: Schedule, x: Tensor, solver: str) -> list[Tensor]:
    """Walk through ours and keep every state."""
    seen = []

    def predict(x: Tensor, t: Tensor) -> Tensor:
        seen.append(x)
        return network(x, t)

    process.schedule = schedule
    generator = torch.Generator().manual_seed(1)

    def noise():
        yield x
        while True:
            yield torch.randn(x.shape, generator=generator)

    last = process.sample(predict, noise(), solver=solver)
    return [*seen[1:], last]


def compare(theirs: list[Tensor], ours: list[Tensor]) -> None:
    assert len(theirs) == len(ours)
    for expected, state in zip(theirs, ours, strict=True):
        # Relative to the state: predictions of epsilon blow it up at the cosine schedule's noisiest steps.
        torch.testing.assert_close(state, expected, rtol=2e-4, atol=2e-5 * max(1.0, expected.abs().max().item()))


@pytest.fixture
def start() -> Tensor:
    return torch.randn(4, 6, 3, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize("schedule", NAMES)
def test_tables(schedule):
    ours = make_schedule(schedule, 1000)
    theirs = scheduler("DDPMScheduler", schedule, "epsilon")
    torch.testing.assert_close(ours.betas.float(), theirs.betas, rtol=1e-4, atol=1e-6)
    torch.testing.assert_close(ours.alphas_cumprod.float(), theirs.alphas_cumprod, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("prediction", PREDICTIONS)
@pytest.mark.parametrize("schedule", NAMES)
def test_ancestral(start, schedule, prediction):
    theirs = scheduler("DDPMScheduler", schedule, prediction, variance_type="fixed_small")
    theirs.set_timesteps(timesteps=list(range(990, -1, -30)))
    ours = make_schedule(schedule, 1000).keep(theirs.timesteps.flip(0))
    compare(
        reference(theirs, start, generator=torch.Generator().manual_seed(1)),
        states(DDPM(1000, schedule, prediction), ours, start, "ancestral"),
    )


@pytest.mark.parametrize("prediction", PREDICTIONS)
@pytest.mark.parametrize("schedule", NAMES)
@pytest.mark.parametrize(("steps", "published"), [("leading50", True), ("ddim20", False)])
def test_ddim(start, schedule, prediction, steps, published):
    """Take MLD's steps (timestep 981 down to 1, ending at abar_0), and an integer stride that ends at clean data."""
    theirs = scheduler(
        "DDIMScheduler", schedule, prediction, set_alpha_to_one=not published, steps_offset=int(published)
    )
    theirs.set_timesteps(int(steps.removeprefix("leading").removeprefix("ddim")))
    ours = make_schedule(schedule, 1000).respace(steps)
    assert torch.equal(theirs.timesteps.flip(0), ours.timesteps)
    compare(reference(theirs, start), states(DDPM(1000, schedule, prediction), ours, start, "ddim"))


@pytest.mark.parametrize("prediction", PREDICTIONS)
@pytest.mark.parametrize("schedule", NAMES)
@pytest.mark.parametrize("steps", [1, 2, 10, 20])
def test_dpmpp_2m(start, schedule, prediction, steps):
    theirs = scheduler("DPMSolverMultistepScheduler", schedule, prediction)
    theirs.set_timesteps(steps)
    ours = make_schedule(schedule, 1000).keep(theirs.timesteps.flip(0))
    compare(reference(theirs, start), states(DDPM(1000, schedule, prediction), ours, start, "dpmpp_2m"))

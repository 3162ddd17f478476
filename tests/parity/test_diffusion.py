"""Compare noise schedules, training errors and sampling steps of MDM, MotionDiffuse, MLD and ReMoDiffuse with theirs.

The networks' outputs are given: what is compared is the process around them.
"""

from __future__ import annotations

import pytest
import torch
from safetensors.torch import load_file
from torch import Tensor

from kinema.diffusion.ddpm import DDPM
from kinema.diffusion.denoising import ancestral
from kinema.diffusion.errors import per_frame, per_sequence
from kinema.diffusion.schedules import make_schedule
from kinema.types import frame_mask

CLOSE = {"rtol": 1e-5, "atol": 1e-5}
SCHEDULES = {
    ("mdm_schedules", "T50"): ("cosine", 50, None),
    ("mdm_schedules", "T1000"): ("cosine", 1000, None),
    ("motiondiffuse_schedules", "T1000"): ("linear", 1000, None),
    ("motiondiffuse_schedules", "respaced10"): ("linear", 1000, 10),
    ("remodiffuse_mixture", "respaced"): ("linear", 1000, "15,15,8,6,6"),
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


def read(golden_file, name: str) -> dict[str, Tensor]:
    return load_file(golden_file(f"diffusion/{name}.safetensors"))


def frames_first(x: Tensor) -> Tensor:
    """Turn MDM's (b, features, 1, frames) into (b, frames, features)."""
    return x[:, :, 0].transpose(1, 2)


@pytest.mark.parametrize(("file", "case"), SCHEDULES)
def test_schedules(golden_file, file, case):
    golden = read(golden_file, file)
    name, steps, respacing = SCHEDULES[file, case]
    schedule = make_schedule(name, steps)
    schedule = schedule if respacing is None else schedule.respace(respacing)
    for array in ARRAYS:
        torch.testing.assert_close(getattr(schedule, array), golden[f"{case}.{array}"], rtol=1e-9, atol=1e-15)
    torch.testing.assert_close(schedule.amplification, golden[f"{case}.sqrt_recipm1_alphas_cumprod"], rtol=1e-9, atol=0)
    timesteps = {
        "respaced10": golden.get("respaced10.timestep_map"),
        "respaced": golden.get("out.timestep_map"),
    }.get(case)
    if timesteps is not None:
        assert torch.equal(schedule.timesteps, timesteps)


def test_mld_schedule(golden_file):
    golden = read(golden_file, "mld_ddim")
    schedule = make_schedule("scaled_linear", 1000)
    torch.testing.assert_close(schedule.betas.float(), golden["out.betas"], rtol=1e-5, atol=1e-9)
    torch.testing.assert_close(schedule.alphas_cumprod.float(), golden["out.alphas_cumprod"], rtol=1e-5, atol=1e-9)
    for steps in (10, 50):
        leading = schedule.respace(f"leading{steps}")
        assert torch.equal(leading.timesteps.flip(0), golden[f"out.timesteps{steps}"])
        end = leading.alphas_cumprod_prev[0].float()
        torch.testing.assert_close(end, golden["out.final_alpha_cumprod"], rtol=1e-6, atol=0)


@pytest.mark.parametrize("masked", ["", "_masked"])
@pytest.mark.parametrize("steps", [50, 1000])
@pytest.mark.parametrize(("name", "prediction"), [("x0", "x0"), ("eps", "epsilon")])
def test_mdm_loss(golden_file, name, prediction, steps, masked):
    golden, process = read(golden_file, "mdm_denoiser"), DDPM(steps, prediction=prediction)
    x0, noise = frames_first(golden["in.x0"]), frames_first(golden["in.noise"])
    time = golden["in.t" if steps == 50 else "in.t_T1000"]
    output = frames_first(golden[f"out.loss_model_output_T{steps}{masked}"])
    noisy = frames_first(golden[f"out.x_t_T{steps}"])
    torch.testing.assert_close(process.add_noise(x0, time, noise), noisy, **CLOSE)
    errors = process.errors(lambda x, t: output, x0, time, noise)
    loss = per_sequence(errors, golden["in.mask"][:, 0, 0])
    torch.testing.assert_close(loss, golden[f"out.loss_{name}_T{steps}{masked}"], **CLOSE)


@pytest.mark.parametrize(
    ("file", "prediction"),
    [
        ("motiondiffuse_denoiser", "epsilon"),
        ("motiondiffuse_denoiser_softmax", "epsilon"),
        ("remodiffuse_denoiser", "x0"),
    ],
)
def test_loss_per_frame(golden_file, file, prediction):
    golden, process = read(golden_file, file), DDPM(1000, "linear", prediction)
    x0, time, noise, output = (golden[key] for key in ("in.x0", "in.t", "in.noise", "out.loss_pred"))
    if "out.loss_x_t" in golden:
        torch.testing.assert_close(process.add_noise(x0, time, noise), golden["out.loss_x_t"], **CLOSE)
    errors = process.errors(lambda x, t: output, x0, time, noise)
    loss = per_frame(errors, frame_mask(golden["in.lengths"], x0.shape[1])).mean()
    torch.testing.assert_close(loss, golden["out.loss"], **CLOSE)


def test_mld_loss(golden_file):
    golden, process = read(golden_file, "mld_denoiser"), DDPM(1000, "scaled_linear")
    latent, time, noise = golden["in.loss_latent"].transpose(0, 1), golden["in.t"], golden["in.loss_noise"]
    torch.testing.assert_close(process.add_noise(latent, time, noise), golden["out.loss_noisy"], **CLOSE)
    loss = process.loss(lambda x, t: golden["out.loss_pred"], latent, time, noise).mean()
    torch.testing.assert_close(loss, golden["out.loss"], **CLOSE)


@pytest.mark.parametrize("file", ["mdm_sample_x0", "mdm_sample_eps"])
def test_first_ancestral_step(golden_file, file):
    """Take the first of 50 steps by the recorded estimate; later ones need the network (its family's tests)."""
    golden, schedule = read(golden_file, file), make_schedule("cosine", 50)
    after_first = []

    def clean(x: Tensor, k: int) -> Tensor:
        after_first.append(x)
        return golden["out.traj_pred_x0"][0]

    ancestral(schedule, clean, iter([golden["rng.x_T"], *golden["rng.steps"]]))
    torch.testing.assert_close(after_first[1], golden["out.traj"][0], **CLOSE)

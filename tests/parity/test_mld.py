"""Compare MLD's autoencoder, denoiser and sampler with the published module (MLD §1-§2)."""

from __future__ import annotations

import pytest
import torch
from safetensors.torch import load_file
from torch import Tensor

from kinema import interop
from kinema.generators.frames.training import FrameDraws
from kinema.generators.mld import MLD, LatentSampling
from kinema.motion.statistics import Statistics
from kinema.tokenizers.vae import VAE
from kinema.types import Latents, MotionBatch, TextFeatures


def read(golden_file, name: str) -> dict[str, Tensor]:
    return load_file(golden_file(f"diffusion/mld_{name}.safetensors"))


def part(golden: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {k.removeprefix(prefix): v for k, v in golden.items() if k.startswith(prefix)}


def load_vae(state: dict[str, Tensor], mean: Tensor | None = None, std: Tensor | None = None) -> VAE:
    mean = torch.zeros(263) if mean is None else mean
    std = torch.ones(263) if std is None else std
    return interop.load("mld-vae", state, statistics=Statistics(mean.double().numpy(), std.double().numpy()))


def load_denoiser(golden: dict[str, Tensor]) -> MLD:
    model = interop.load("mld", part(golden, "sd."))
    model.take_empty_text(text_of(golden["in.null_text"]))
    return model


def text_of(features: Tensor) -> TextFeatures:
    return TextFeatures([""] * len(features), features[:, 0])


def first(x: Tensor) -> Tensor:
    """Turn (tokens, batch, d) into (batch, tokens, d)."""
    return x.transpose(0, 1)


def close(ours: Tensor, theirs: Tensor, atol: float = 1e-5) -> None:
    torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=atol)


@pytest.fixture
def vae(golden_file):
    golden = read(golden_file, "vae")
    mean, std = golden["in.mean"], golden["in.std"]
    model = load_vae(part(golden, "sd."), mean, std)
    motion = MotionBatch(golden["in.x"] * std + mean, golden["in.lengths"])
    return golden, model, motion


def test_posterior(vae):
    golden, model, motion = vae
    mean, log_variance = model._moments(golden["in.x"], motion.lengths).values.chunk(2, dim=-1)
    close(mean, first(golden["out.mu"]))
    close(log_variance, first(golden["out.logvar"]))
    close((log_variance / 2).exp(), first(golden["out.std"]))
    close(mean + (log_variance / 2).exp() * first(golden["rng.eps"]), first(golden["out.latent"]))


def test_decoding(vae):
    golden, model, motion = vae
    decoded = model.decode(Latents(model.space.latents_of(motion.lengths), motion.lengths, first(golden["in.z"])))
    close(model.representation.normalize(decoded.features, decoded.lengths), golden["out.decoded"])
    output = model._decode(first(golden["out.latent"]), motion.lengths, 20)
    close(output, golden["out.reconstruction"])
    close(model._joints(golden["in.x"]), golden["out.joints_reference"])
    close(model._joints(output), golden["out.joints_reconstruction"], 2e-5)


def test_reconstruction_loss(vae):
    golden, model, motion = vae
    losses = model.loss(motion, noise=first(golden["rng.eps"]))
    close(losses["reconstruction"], golden["out.loss_recons_feature"])
    close(losses["joints"], golden["out.loss_recons_joints"])
    close(losses["kl"], golden["out.loss_kl_motion"])
    close(losses["loss"], golden["out.loss_total"])


def test_denoiser(golden_file):
    golden = read(golden_file, "denoiser")
    model = load_denoiser(golden)
    x, time, text = golden["in.noisy"], golden["in.t"], text_of(golden["in.text"])
    condition, _ = model.denoiser.read(text)
    close(model.denoiser.embed_time(time), golden["out.time_embedding"])
    close(condition, golden["out.text_projection"])
    close(model.denoiser(x, time, condition), golden["out.pred"])
    close(model.denoiser(x, time, *model.denoiser.read(model.without_text(text))), golden["out.pred_null"])


def test_loss(golden_file):
    golden = read(golden_file, "denoiser")
    model = load_denoiser(golden)
    latents = first(golden["in.loss_latent"])
    draws = FrameDraws(torch.zeros(3, dtype=torch.bool), golden["in.t"], golden["in.loss_noise"])
    close(model.process.add_noise(latents, draws.time, draws.noise), golden["out.loss_noisy"])
    ones = torch.ones(3, dtype=torch.long)
    losses = model.loss(Latents(ones, 20 * ones, latents), text_of(golden["in.text"]), draws=draws)
    close(losses["loss"], golden["out.loss"])


@pytest.mark.parametrize(("steps", "guidance"), [(50, 7.5), (50, 1.0), (10, 7.5)])
def test_sampling(golden_file, steps, guidance):
    golden = read(golden_file, "ddim")
    model = load_denoiser(golden)
    _, schedule = model.process.resolve("ddim", f"leading{steps}")
    assert torch.equal(schedule.timesteps.flip(0), golden[f"out.timesteps{steps}"])
    close(schedule.alphas_cumprod_prev[0].float(), golden["out.final_alpha_cumprod"])
    close(model.process.schedule.alphas_cumprod.float(), golden["out.alphas_cumprod"])
    sampling = LatentSampling(guidance=guidance, solver="ddim", solver_steps=f"leading{steps}")
    made = model.sample(
        text_of(golden["in.text"]),
        golden["in.lengths"],
        seeds=torch.zeros(3, dtype=torch.long),
        sampling=sampling,
        noise=iter([golden["rng.init"]]),
    )
    close(made.values, first(golden[f"out.ddim{steps}_cfg{guidance:g}"]))
    assert torch.equal(made.frames, golden["in.lengths"])
    if (steps, guidance) == (50, 7.5):
        vae = load_vae(part(golden, "sd_vae."))
        close(vae.decode(made).features, golden["out.motion"], 2e-5)

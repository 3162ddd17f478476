"""Compare MDM with the published modules: networks, guidance, losses, sampling and editing, its draws injected."""

from __future__ import annotations

import pytest
import torch
from safetensors.torch import load_file
from torch import Tensor

from kinema import interop
from kinema.diffusion.errors import per_sequence
from kinema.generators.frames.training import FrameDraws
from kinema.generators.mdm import MDM, FrameSampling
from kinema.generators.texts import without_text
from kinema.types import Known, Latents, TextFeatures, frame_mask

STEPS = 50


def read(golden_file, name: str) -> dict[str, Tensor]:
    return load_file(golden_file(f"diffusion/mdm_{name}.safetensors"))


def load_model(golden: dict[str, Tensor], frames: int, **options) -> MDM:
    state = {k.removeprefix("sd."): v for k, v in golden.items() if k.startswith("sd.")}
    return interop.load("mdm", {"model_avg": state}, max_frames=frames, **options)


def rows(x: Tensor) -> Tensor:
    """Turn (..., features, 1, frames) into (..., frames, features)."""
    return x.squeeze(-2).transpose(-1, -2)


def text_of(golden: dict[str, Tensor]) -> TextFeatures:
    pooled = golden["in.text_embed"][0]
    return TextFeatures([""] * len(pooled), pooled)


def close(ours: Tensor, theirs: Tensor, atol: float = 4e-5) -> None:
    torch.testing.assert_close(ours, theirs, rtol=1e-5, atol=atol)


@pytest.mark.parametrize("mask_frames", [False, True])
def test_encoder(golden_file, mask_frames):
    golden = read(golden_file, "denoiser")
    model = load_model(golden, 16, mask_frames=mask_frames)
    x, time, real = rows(golden["in.x"]), golden["in.t"], frame_mask(golden["in.lengths"], 16)
    real, end = (real, "_masked") if mask_frames else (None, "")
    close(model.denoiser.embed_time(time), golden["out.time_emb"], 1e-5)
    text = text_of(golden)
    outputs = [model.denoiser(x, time, *model.denoiser.read(t), real) for t in (text, without_text(text))]
    outputs.append(
        model._predictor(text, real, FrameSampling(guidance=2.5), torch.zeros(len(x), dtype=torch.long))(
            x, torch.cat((time, time))
        )
    )
    computed = torch.ones(x.shape[:2], dtype=torch.bool) if real is None else real
    for ours, name in zip(outputs, ("cond", "uncond", "cfg"), strict=True):
        close(ours, rows(golden[f"out.{name}{end}"]) * computed[..., None], 7e-5 if name == "cfg" else 4e-5)


@pytest.mark.parametrize("mask_frames", [False, True])
@pytest.mark.parametrize("steps", [50, 1000])
@pytest.mark.parametrize("prediction", ["x0", "epsilon"])
def test_loss_per_sample(golden_file, prediction, steps, mask_frames):
    golden = read(golden_file, "denoiser")
    model = load_model(golden, 16, prediction=prediction, steps=steps, mask_frames=mask_frames)
    time = golden["in.t" if steps == 50 else "in.t_T1000"]
    noise, x0, lengths = rows(golden["in.noise"]), rows(golden["in.x0"]), golden["in.lengths"]
    close(model.process.add_noise(x0, time, noise), rows(golden[f"out.x_t_T{steps}"]), 1e-5)
    draws = FrameDraws(torch.zeros(3, dtype=torch.bool), time, noise)
    real = frame_mask(lengths, 16)
    losses = per_sequence(model.errors(x0, text_of(golden), draws, real), real)
    name = {"x0": "x0", "epsilon": "eps"}[prediction]
    expected = golden[f"out.loss_{name}_T{steps}{'_masked' if mask_frames else ''}"]
    close(losses, expected, 1e-5)
    latents = Latents(lengths, lengths, values=x0)
    close(model.loss(latents, text_of(golden), draws=draws)["loss"], expected.mean(), 1e-5)


def test_decoder_over_tokens(golden_file):
    golden = read(golden_file, "decoder_tokens")
    model = load_model(golden, 14, heads=2, words=True)
    tokens, seen = golden["in.text_tokens"].transpose(0, 1), ~golden["in.text_padding"]
    text = TextFeatures([""] * 3, tokens[:, 0], tokens, seen)
    x, real = rows(golden["in.x"]), frame_mask(golden["in.lengths"], 14)
    for t, name in ((text, "cond"), (without_text(text), "uncond")):
        made = model.denoiser(x, golden["in.t"], *model.denoiser.read(t), real)
        close(made, rows(golden[f"out.{name}"]) * real[..., None])  # padding isn't computed


GUIDANCE = {"sample_cfg2.5": 2.5, "sample_cfg1": 1.0, "sample_uncond": 0.0, "sample_cfg2.5_no_frame_mask": 2.5}


def draws_of(golden: dict[str, Tensor]):
    return iter([rows(golden["rng.x_T"]), *rows(golden["rng.steps"])])


@pytest.mark.parametrize("name", GUIDANCE)
@pytest.mark.parametrize("prediction", ["x0", "epsilon"])
def test_samples(golden_file, prediction, name):
    golden = read(golden_file, "sample_x0" if prediction == "x0" else "sample_eps")
    model = load_model(golden, 14, prediction=prediction, mask_frames="no_frame_mask" not in name)
    made = model.sample(
        text_of(golden),
        golden["in.lengths"],
        seeds=torch.zeros(3, dtype=torch.long),
        sampling=FrameSampling(guidance=GUIDANCE[name]),
        noise=draws_of(golden),
    )
    expected = rows(golden[f"out.{name}"])
    close(made.values[made.mask], expected[made.mask], 2e-4 if prediction == "x0" else 8e-2)
    assert not made.values[~made.mask].any()


@pytest.mark.parametrize(("name", "guidance"), [("inbetween", 2.5), ("inbetween", 0.0), ("columns", 2.5)])
def test_edits(golden_file, name, guidance):
    golden = read(golden_file, "sample_x0")
    model = load_model(golden, 14)
    latents = Latents(golden["in.lengths"], golden["in.lengths"], values=rows(golden["in.motion"]))
    known = Known(latents, rows(golden[f"in.{name}_keep"]))
    made = model.sample(
        text_of(golden),
        None,
        seeds=torch.zeros(3, dtype=torch.long),
        known=known,
        sampling=FrameSampling(guidance=guidance),
        noise=draws_of(golden),
    )
    expected = rows(golden[f"out.{name}_{'cfg2.5' if guidance else 'uncond'}"])
    close(made.values[made.mask], expected[made.mask], 1e-4)

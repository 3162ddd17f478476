"""Compare MotionDiffuse with the published modules: text head, blocks, loss and sampling, its draws injected."""

from __future__ import annotations

import pytest
import torch
from safetensors.torch import load_file
from torch import Tensor

from kinema import interop
from kinema.diffusion.errors import per_frame
from kinema.generators.frames.training import FrameDraws
from kinema.generators.motiondiffuse import FrameSampling, MotionDiffuse
from kinema.nn.embeddings import timestep_embedding
from kinema.types import Latents, TextFeatures, frame_mask

FILES = {"linear": "denoiser", "softmax": "denoiser_softmax"}


def read(golden_file, name: str) -> dict[str, Tensor]:
    return load_file(golden_file(f"diffusion/motiondiffuse_{name}.safetensors"))


def load_model(golden: dict[str, Tensor], **options) -> MotionDiffuse:
    state = {k.removeprefix("sd."): v for k, v in golden.items() if k.startswith("sd.")}
    return interop.load("motiondiffuse", {"encoder": state}, heads=4, **options)


def close(ours: Tensor, theirs: Tensor, atol: float = 5e-5) -> None:
    torch.testing.assert_close(ours, theirs, rtol=1e-5, atol=atol)


def close_but_for_rounding(ours: list[Tensor], theirs: list[Tensor], attention: str, atol: float) -> None:
    """Compare samples; the published softmax adds -1e5 to the scores of padded queries and so rounds them to 0.008.

    That reaches the later frames of all but the sample that has no padding.
    """
    close(ours[0], theirs[0], atol)
    for own, other in zip(ours[1:], theirs[1:], strict=True):
        close(own, other, atol if attention == "linear" else 2e-3)


def computed(golden: dict[str, Tensor], attention: str, x: Tensor) -> list[Tensor]:
    """Take each sample's frames that ours computes, of padded samples or of the rows of all."""
    real = visible(golden, attention)
    counts = [18] * len(golden["in.lengths"]) if real is None else golden["in.lengths"].tolist()
    if x.ndim == 2:
        return list(x.split(counts))
    return [own[:count] for own, count in zip(x, counts, strict=True)]


def visible(golden: dict[str, Tensor], attention: str) -> Tensor | None:
    """Return the mask of frames: the published softmax hides none, whatever it was meant to."""
    return frame_mask(golden["in.lengths"], 18) if attention == "linear" else None


@pytest.mark.parametrize("attention", FILES)
def test_denoiser(golden_file, attention):
    golden = read(golden_file, FILES[attention])
    model = load_model(golden, attention=attention).denoiser
    time, real, seen = golden["in.t"], visible(golden, attention), {}
    condition = model.read_tokens(golden["in.clip_token_features"], golden["in.clip_tokens"].argmax(1))
    close(condition[:, 1:], golden["out.xf_out"], 7e-5)
    sentence = model.sentence_projection(condition[:, 0])
    close(sentence, golden["out.xf_proj"])
    close(timestep_embedding(time, 32), golden["out.timestep_embedding"], 1e-5)
    close(model.embed_time(time) + sentence, golden["out.emb"])
    parts = {"block0": model.blocks[0], "block1": model.blocks[1]}
    parts |= {
        f"block0.{n}": p for n, p in zip(("sa_block", "ca_block", "ffn"), model.blocks[0].children(), strict=True)
    }
    for name, part in parts.items():
        part.register_forward_hook(lambda *call, name=name: seen.update({name: call[-1]}))
    predicted = model(golden["in.x"], time, condition, None, real)
    for name, output in ({"pred": predicted} | seen).items():
        ours, theirs = (computed(golden, attention, x) for x in (output, golden[f"out.{name}"]))
        close_but_for_rounding(ours, theirs, attention, 2e-5 if name == "pred" else 5e-5)


@pytest.mark.parametrize("attention", FILES)
def test_loss(golden_file, attention):
    golden = read(golden_file, FILES[attention])
    model, x0, time, noise = (
        load_model(golden, attention=attention),
        golden["in.x0"],
        golden["in.t"],
        golden["in.noise"],
    )
    x_t = model.process.add_noise(x0, time, noise)
    close(x_t, golden["out.loss_x_t"], 1e-5)
    condition = model.denoiser.read_tokens(golden["in.clip_token_features"], golden["in.clip_tokens"].argmax(1))
    predicted = model.denoiser(x_t, time, condition, None, visible(golden, attention))
    ours, theirs = (computed(golden, attention, x) for x in (predicted, golden["out.loss_pred"]))
    close_but_for_rounding(ours, theirs, attention, 2e-5)
    errors = (predicted - noise).square()
    close(per_frame(errors, frame_mask(golden["in.lengths"], 18)).mean(), golden["out.loss"], 1e-5)


def test_the_step_s_loss_is_that_average(golden_file):
    """Take whole texts, whose last token is their end."""
    golden = read(golden_file, "denoiser")
    model, lengths = load_model(golden), golden["in.lengths"]
    tokens = golden["in.clip_token_features"]
    text = TextFeatures([""] * 3, tokens[:, 0], tokens)
    drawn, real = (
        FrameDraws(torch.zeros(3, dtype=torch.bool), golden["in.t"], golden["in.noise"]),
        frame_mask(lengths, 18),
    )
    condition = model.denoiser.read_tokens(tokens, torch.full((3,), 76))
    predicted = model.denoiser(golden["out.loss_x_t"], golden["in.t"], condition, None, real)
    expected = (predicted - golden["in.noise"]).square()[real].mean()
    latents = Latents(lengths, lengths, values=golden["in.x0"])
    close(model.loss(latents, text, draws=drawn)["loss"], expected, 1e-5)


@pytest.mark.parametrize(("steps", "name"), [(None, "1000"), (10, "respaced10")])
def test_samples(golden_file, steps, name):
    golden = read(golden_file, "sample")
    model = load_model(golden)
    words, sentence = golden["in.xf_out"], golden["in.xf_proj"]  # given in the place of the text head's
    model.denoiser.read = lambda text: (torch.cat((words[:, :1], words), dim=1), None)
    model.denoiser.sentence_projection.register_forward_hook(lambda *call: sentence)
    made = model.sample(
        TextFeatures(["", ""], torch.zeros(2, 1)),
        golden["in.lengths"],
        seeds=torch.zeros(2, dtype=torch.long),
        sampling=FrameSampling(solver_steps=steps),
        noise=iter([golden["rng.x_T"], *golden[f"rng.steps_{steps or 1000}"]]),
    )
    close(made.values[made.mask], golden[f"out.sample_{name}"][made.mask], 6e-5)

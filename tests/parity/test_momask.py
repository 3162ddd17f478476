"""Compare MoMask's two transformers, their training losses, generation and edits with the published modules."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from torch import Tensor

from kinema import interop
from kinema.generators.momask.model import MoMask, MoMaskDraws, MoMaskSampling, corrupt, select
from kinema.generators.tokens.encoder import guided_logits
from kinema.generators.tokens.residual import ResidualDraws, ResidualSampling, ResidualTransformer, drawn_layer
from kinema.interop import momask, momask_residual
from kinema.motion.statistics import Statistics
from kinema.types import Known, Latents, TextFeatures, frame_mask

CLOSE = {"rtol": 1e-4, "atol": 1e-5}
FORMS = ("shared", "separate")
GREEDY = MoMaskSampling(temperature=0, residual_temperature=0)
SEEDS = torch.tensor([1, 2, 3])


def read(golden_file, name: str) -> dict[str, Tensor]:
    return load_file(golden_file(f"vq/{name}.safetensors"))


def state(golden: dict[str, Tensor], prefix: str = "sd.") -> dict[str, Tensor]:
    return {k.removeprefix(prefix): v for k, v in golden.items() if k.startswith(prefix)}


def load_base(golden_file) -> MoMask:
    content = {"t2m_transformer": state(read(golden_file, "momask_base")), "ep": 3}
    return interop.load("momask", content, heads=4, max_latents=14).requires_grad_(False)


def load_residual(golden_file, form: str = "shared") -> ResidualTransformer:
    content = {"res_transformer": state(read(golden_file, "momask_residual"), f"{form}.sd.")}
    return interop.load("momask-residual", content, heads=4, max_latents=14).requires_grad_(False)


def features(golden: dict[str, Tensor]) -> TextFeatures:
    return TextFeatures(["", "", ""], golden["in.text"])


# The masked transformer


def test_logits(golden_file):
    golden, model = read(golden_file, "momask_base"), load_base(golden_file)
    ids, text, real = golden["in.ids"], golden["in.text"], ~golden["in.padding_mask"]
    for name, logits in (
        ("cond", model(ids, text, real)),
        ("uncond", model(ids, text * 0, real)),
        ("cfg4", guided_logits(model, ids, text, real, scale=4)),
    ):  # padding isn't computed
        torch.testing.assert_close(logits.mT, golden[f"out.logits_{name}"] * real[:, None], **CLOSE)


def test_training_loss(golden_file):
    golden, model = read(golden_file, "momask_base"), load_base(golden_file)
    lengths, codes = golden["in.lens"], golden["loss.in.ids"]
    draws = MoMaskDraws(
        mask_time=golden["loss.in.uniform_time"],
        permutation=golden["loss.in.uniform_order"].argsort(dim=1),
        to_random=golden["loss.in.random_mask"],
        to_mask=golden["loss.in.mask_mask"],
        random_codes=golden["loss.in.random_ids"],
        condition_drop=torch.zeros(3, dtype=torch.bool),
    )
    real = frame_mask(lengths, 14)
    selected = select(draws, real, 14)
    assert torch.equal(selected, golden["loss.in.selected"])
    ids = corrupt(codes, selected, model.mask_id, draws).masked_fill(~real, model.pad_id)
    assert torch.equal(ids, golden["loss.out.input_ids"])
    predicted = model(ids, golden["in.text"], real).argmax(-1)
    assert torch.equal(predicted[real], golden["loss.out.pred_ids"][real])
    latents = Latents(lengths=lengths, frames=lengths * 4, codes=codes[..., None])
    losses = model.loss(latents, features(golden), draws=draws)
    torch.testing.assert_close(losses["loss"], golden["loss.out.loss"], **CLOSE)
    torch.testing.assert_close(losses["accuracy"], golden["loss.out.acc"], **CLOSE)


# The residual transformer


@pytest.mark.parametrize("form", FORMS)
def test_residual_layers(golden_file, form):
    golden, model = read(golden_file, "momask_residual"), load_residual(golden_file, form)
    codes, text, real = golden["in.indices"], golden["in.text"], ~golden["in.padding_mask"]
    padded = codes.masked_fill(~real[..., None], model.codebook_size)
    for q in (1, 2, 3):
        layer = torch.full((3,), q)
        history = model.history(padded, layer)
        expected = golden[f"{form}.out.history_q{q}"]
        torch.testing.assert_close(history[: len(expected)], expected, **CLOSE)
        logits = model(history, text, layer, real)
        torch.testing.assert_close(logits[real], golden[f"{form}.out.logits_q{q}"].mT[real], **CLOSE)
        guided = guided_logits(model, history, text, layer, real, scale=5)
        torch.testing.assert_close(guided[real], golden[f"{form}.out.logits_q{q}_cfg5"].mT[real], **CLOSE)


@pytest.mark.parametrize("form", FORMS)
def test_residual_training_loss(golden_file, form):
    golden, model = read(golden_file, "momask_residual"), load_residual(golden_file, form)
    uniform = golden[f"{form}.rng.uniform_q"]
    assert torch.equal(drawn_layer(uniform, 4), golden[f"{form}.out.active_q"])
    lengths = golden["in.lens"]
    latents = Latents(lengths=lengths, frames=lengths * 4, codes=golden["in.indices"])
    draws = ResidualDraws(uniform, torch.zeros(3, dtype=torch.bool))
    losses = model.loss(latents, features(golden), draws=draws)
    torch.testing.assert_close(losses["loss"], golden[f"{form}.out.loss"], **CLOSE)
    torch.testing.assert_close(losses["accuracy"], golden[f"{form}.out.acc"], **CLOSE)


# Generation


class Gumbel:
    """Add recorded Gumbel noise to the logits, as the published code does."""

    def __init__(self, uniform: Tensor) -> None:
        self.uniform = uniform

    def order(self, size: int) -> Tensor:
        raise AssertionError("MoMask draws no order")

    def pick(self, step: int, logits: Tensor) -> Tensor:
        inner = -self.uniform[step].clamp(min=1e-20).log()
        return (logits - inner.clamp(min=1e-20).log()).argmax(-1)


def expected_codes(golden: dict[str, Tensor], name: str) -> Tensor:
    """Give recorded ids with 0 in place of -1 behind the length, as "b n q"."""
    ids = golden[f"out.{name}"].clamp(min=0)
    return ids if ids.ndim == 3 else ids[..., None]


def test_base_generation(golden_file):
    golden, model = read(golden_file, "momask_generate"), load_base(golden_file)
    frames = golden["in.lens"] * 4
    greedy = model.sample(features(golden), frames, seeds=SEEDS, sampling=GREEDY)
    assert torch.equal(greedy.codes, expected_codes(golden, "base_greedy"))
    drawn = model.sample(features(golden), frames, seeds=SEEDS, draws=Gumbel(golden["rng.base_uniform"]))
    assert torch.equal(drawn.codes, expected_codes(golden, "base_gumbel"))


def test_base_edit(golden_file):
    golden, model = read(golden_file, "momask_generate"), load_base(golden_file)
    lengths = golden["in.lens"]
    source = Latents(lengths=lengths, frames=lengths * 4, codes=golden["in.edit_tokens"][..., None])
    known = Known(source, ~golden["in.edit_mask"])
    edited = model.sample(features(golden), None, seeds=SEEDS, known=known, sampling=GREEDY)
    assert torch.equal(edited.codes, expected_codes(golden, "base_edit_greedy"))


def base_codes(golden: dict[str, Tensor]) -> Latents:
    lengths = golden["in.lens"]
    return Latents(lengths=lengths, frames=lengths * 4, codes=expected_codes(golden, "base_greedy"))


@pytest.mark.parametrize(("form", "name"), [("shared", "residual_greedy"), ("separate", "residual_greedy_separate")])
def test_residual_layers_complete_the_base(golden_file, form, name):
    golden = read(golden_file, "momask_generate")
    model = load_residual(golden_file, form)
    greedy = ResidualSampling(temperature=0)
    completed = model.complete(base_codes(golden), features(golden), seeds=SEEDS, sampling=greedy)
    assert torch.equal(completed.codes, expected_codes(golden, name))


def test_residual_layers_with_recorded_noise(golden_file):
    golden, model = read(golden_file, "momask_generate"), load_residual(golden_file)
    draws = Gumbel(golden["rng.residual_uniform"])
    completed = model.complete(base_codes(golden), features(golden), seeds=SEEDS, draws=draws)
    assert torch.equal(completed.codes, expected_codes(golden, "residual_gumbel"))


def test_base_and_residual_to_motion(golden_file):
    """Compare the frames before each end; behind it the published decoder goes on."""
    golden = read(golden_file, "momask_generate")
    model = load_base(golden_file)
    model.attach("residual", load_residual(golden_file))
    latents = model.sample(features(golden), golden["in.lens"] * 4, seeds=SEEDS, sampling=GREEDY)
    assert torch.equal(latents.codes, expected_codes(golden, "residual_greedy"))
    tokenizer = interop.load(
        "momask-rvq",
        {"vq_model": state(read(golden_file, "rvq_momask"))},
        statistics=Statistics(np.zeros(263), np.ones(263)),
        mask_padding=False,
    )
    tokenizer.representation.std.fill_(1.0)  # the published variant divides some of them
    motion = tokenizer.decode(latents)
    torch.testing.assert_close(motion.features[motion.mask], golden["out.motion"][motion.mask], **CLOSE)


def test_length_estimator(golden_file):
    golden = read(golden_file, "momask_length_estimator")
    model = interop.load("length-estimator", {"estimator": state(golden), "epoch": 1})
    logits = model(golden["in.text"])
    torch.testing.assert_close(logits, golden["out.logits"], **CLOSE)
    torch.testing.assert_close(logits.softmax(dim=1), golden["out.probs"], **CLOSE)
    assert torch.equal(logits.argmax(dim=1) * model.downsample, golden["out.argmax_frames"])
    counts = golden["in.token_len"]
    loss = model.loss(Latents(counts, counts * 4), TextFeatures([""] * 5, golden["in.text"]))["loss"]
    torch.testing.assert_close(loss, golden["out.loss"], **CLOSE)


# Round trips


def test_export_gives_the_published_state_dict_back(golden_file):
    published = state(read(golden_file, "momask_base"))
    written = momask.export(load_base(golden_file))
    assert written.keys() == published.keys()
    for key, value in written.items():
        torch.testing.assert_close(value, published[key], **CLOSE)


@pytest.mark.parametrize("form", FORMS)
def test_export_of_the_residual_transformer(golden_file, form):
    published = state(read(golden_file, "momask_residual"), f"{form}.sd.")
    written = momask_residual.export(load_residual(golden_file, form))
    assert written.keys() == published.keys()
    unused = "output_proj_bias"
    for key, value in written.items():
        rows = slice(-1) if key == unused else slice(None)
        torch.testing.assert_close(value[rows], published[key][rows], **CLOSE)

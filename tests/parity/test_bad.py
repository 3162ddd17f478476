"""Compare BAD with the published modules: masks, transformer, OAAS and CBS with their traces, editing."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from torch import Tensor

from kinema import interop
from kinema.generators.bad.model import BAD
from kinema.generators.bad.sampling import BadSampling
from kinema.generators.bad.training import BadDraws
from kinema.interop import bad
from kinema.masking import hybrid_mask, official_inference_mask, shrinking_counts
from kinema.motion.statistics import Statistics
from kinema.nn.embeddings import sinusoidal_positions
from kinema.pipeline.editing import task_slices, task_slots
from kinema.types import Known, Latents, MotionBatch, TextFeatures, frame_mask

CLOSE = {"rtol": 1e-4, "atol": 1e-5}
END, PAD, MASK = 24, 25, 26
MODELS = ("bad_transformer", "bad_transformer_notime")
FLAGS = [(time, ge, hide) for time in (0, 1) for ge in (0, 1) for hide in (0, 1)]


def read(golden_file, name: str) -> dict[str, Tensor]:
    return load_file(golden_file(f"vq/{name}.safetensors"))


def state(golden: dict[str, Tensor]) -> dict[str, Tensor]:
    return {k.removeprefix("sd."): v for k, v in golden.items() if k.startswith("sd.")}


def load(golden_file, name: str = "bad_transformer", **options) -> BAD:
    return interop.load("bad", {"trans": state(read(golden_file, name))}, heads=4, words="all", **options)


def load_tokenizer(golden_file):
    """Load the tokenizer that lies in the transformer's file, for normalised features (mean 0, std 1)."""
    nested = bad.tokenizer(state(read(golden_file, "bad_transformer")))
    tokenizer = interop.load("mmm-vq", {"net": nested}, statistics=Statistics(np.zeros(263), np.ones(263)))
    tokenizer.representation.std.fill_(1.0)  # the published variant divides some of them
    return tokenizer.requires_grad_(False)


def text(golden: dict[str, Tensor], rows: slice = slice(None)) -> TextFeatures:
    pooled, words = golden["in.text"][rows], golden["in.words"][rows]
    return TextFeatures([""] * len(pooled), pooled, words, torch.ones(words.shape[:2], dtype=torch.bool))


def ids_of(codes: Tensor, lengths: Tensor, slots: int) -> Tensor:
    """Write codes as the published ids: END behind them, PAD to the end."""
    ids = torch.nn.functional.pad(codes, (0, slots - codes.shape[1]))
    ids = ids.masked_fill(~frame_mask(lengths, slots), PAD)
    return ids.scatter(1, lengths[:, None], END)


# Masks and network


@pytest.mark.parametrize("flags", FLAGS)
def test_training_and_first_inference_masks(golden_file, flags):
    golden, (time, ge, hide) = read(golden_file, "bad_masks"), flags
    rules = {"conditions": 1 + time, "direction": "ge" if ge else "le", "unmasked_see_masks": not hide}
    lengths, orders = golden["in.lens"], golden["in.orders"]
    all_masked = frame_mask(lengths, orders.shape[1])
    name = f"time{time}_z0all{ge}_unmasked{hide}"
    assert torch.equal(hybrid_mask(orders, golden["in.masked"], lengths, **rules), golden[f"out.train.{name}"])
    assert torch.equal(hybrid_mask(orders, all_masked, lengths, **rules), golden[f"out.infer.{name}"])
    if f"out.infer_arranged.{name}" in golden:
        arranged = torch.arange(orders.shape[1]).expand_as(orders)
        assert torch.equal(hybrid_mask(arranged, all_masked, lengths, **rules), golden[f"out.infer_arranged.{name}"])


@pytest.mark.parametrize("name", MODELS)
def test_transformer(golden_file, name):
    golden, model = read(golden_file, name), load(golden_file, name)
    lengths, masked = golden["in.lens"], golden["in.masked"]
    ahead = model.conditions
    assert model.max_latents == 49
    # The recorded batch has 14 slots, END among them; ours appends one.
    inputs = (golden["in.ids"], torch.zeros_like(masked), golden["in.orders"], lengths)
    visible = golden["out.mask"]
    embedded = model.transformer.embed(golden["in.ids"]) + sinusoidal_positions(14, 32)
    torch.testing.assert_close(embedded, golden["out.token_embedding"], **CLOSE)
    assert torch.equal(hybrid_mask(golden["in.orders"], masked, lengths, **model.rules), visible)
    time = model.time_token(masked, lengths)
    if "out.time_token" in golden:
        torch.testing.assert_close(time[:, 0], golden["out.time_token"], **CLOSE)
    real = torch.arange(14) <= lengths[:, None]  # padding isn't computed
    logits = model.transformer(inputs[0], text(golden), real, time, visible)[:, ahead:]
    torch.testing.assert_close(logits[real], golden["out.logits"][real], **CLOSE)
    whole = model(golden["in.ids"], masked, golden["in.orders"], lengths, text(golden))
    torch.testing.assert_close(whole[:, ahead:-1][real], golden["out.logits"][real], **CLOSE)


@pytest.mark.parametrize("name", MODELS)
def test_training_loss(golden_file, name):
    golden, model = read(golden_file, name), load(golden_file, name)
    lengths, masked = golden["in.lens"], golden["in.masked"]
    codes = golden["in.target"].masked_fill(golden["in.target"] >= END, 0)
    draws = BadDraws(
        keep=golden["in.keep"],
        replacement=golden["in.random_ids"],
        ratio=masked.sum(dim=1) / lengths,
        candidates=(~masked).float(),
        order=golden["in.orders"].float(),
    )
    losses = model.loss(Latents(lengths, lengths * 4, codes=codes[..., None]), text(golden), draws=draws)
    torch.testing.assert_close(losses["loss"], golden["out.loss"], **CLOSE)
    # The recorded accuracy counts all positions alike, ours is each sample's, averaged.
    hits = (golden["out.logits"].argmax(-1) == golden["in.target"]) & frame_mask(lengths, codes.shape[1])
    torch.testing.assert_close(100 * hits.sum() / lengths.sum(), golden["out.acc_percent"], **CLOSE)
    torch.testing.assert_close(losses["accuracy"], (hits.sum(dim=1) / lengths).mean(), **CLOSE)


def test_schedule(golden_file):
    golden = read(golden_file, "schedules")
    assert torch.equal(shrinking_counts(golden["in.tokens_len"], 10).T, golden["out.bad_mmm_masked"])


# Sampling


class Recorded:
    """Replay a recorded permutation, and uniform numbers for Gumbel noise."""

    def __init__(self, orders: Tensor, uniform: Tensor | None = None) -> None:
        self.orders, self.uniform = orders, uniform

    def order(self, size: int) -> Tensor:
        return self.orders[:, :size].float()

    def pick(self, step: int, logits: Tensor) -> Tensor:
        u = self.uniform[step][:, : logits.shape[1]]
        return (logits - (-u.clamp(1e-20).log()).clamp(1e-20).log()).argmax(-1)


def sampled(golden_file, golden, case: str, rows: slice, *, direction: str = "ge", **options):
    """Sample a recorded case; give its orders, lengths and trajectory."""
    lengths = golden["in.tokens_len"][rows]
    if case.startswith("single"):
        lengths = torch.tensor([int(case.removeprefix("single")) // 4])
    model = load(golden_file, direction=direction)
    orders = golden[f"{case}.in.orders"]
    steps = model.trajectory(
        text(golden, rows),
        lengths * 4,
        seeds=torch.zeros(len(lengths), dtype=torch.long),
        sampling=BadSampling(official_inference_mask=True, **options),
        draws=Recorded(orders, golden.get(f"{case}.rng.uniform")),
    )
    return model, orders, lengths, list(steps)


def check_trace(golden, case: str, model, orders: Tensor, lengths: Tensor, steps: list) -> None:
    """Compare inputs, masks and results with the recorded ones; rows of slots that we don't have follow the rule."""
    inputs, masks = golden[f"{case}.trace.input_ids"], golden.get(f"{case}.trace.mask")
    free = frame_mask(lengths, 50)
    before = torch.zeros(len(lengths), int(lengths.max()), dtype=torch.long)
    assert len(steps) == len(inputs)
    for i, (masked, visible, latents) in enumerate(steps):
        read = torch.where(masked, MASK + orders[:, : masked.shape[1]], before)
        assert torch.equal(ids_of(read, lengths, 50), inputs[i])
        if masks is not None:
            size = visible.shape[1]
            assert torch.equal(visible, masks[i][:, :size, :size])
            hidden = torch.nn.functional.pad(masked, (0, 50 - masked.shape[1]))
            assert torch.equal(official_inference_mask(orders, free, hidden, lengths, **model.rules), masks[i])
        before = latents.codes[..., 0]
    assert torch.equal(ids_of(before, lengths, 50), golden[f"{case}.out.ids"])


ALL, FIRST, SECOND = slice(0, 3), slice(0, 1), slice(1, 2)


@pytest.mark.parametrize(
    ("case", "rows", "options"),
    [
        ("batch", ALL, {}),
        ("single44", FIRST, {}),
        ("single96", FIRST, {}),
        ("arranged", ALL, {"orders": "arranged"}),
        ("z0le", ALL, {"direction": "le"}),
    ],
)
def test_oaas(golden_file, case, rows, options):
    golden = read(golden_file, "bad_oaas")
    check_trace(golden, case, *sampled(golden_file, golden, case, rows, **options))


@pytest.mark.parametrize(
    ("case", "rows", "options"),
    [
        ("batch", ALL, {"temperature": 0}),
        ("single44", SECOND, {"temperature": 0}),
        ("single96", SECOND, {"temperature": 0}),
        ("z0le", ALL, {"temperature": 0, "direction": "le"}),
        ("gumbel", ALL, {}),
    ],
)
def test_cbs(golden_file, case, rows, options):
    golden = read(golden_file, "bad_cbs")
    check_trace(golden, case, *sampled(golden_file, golden, case, rows, sampler="cbs", **options))


def test_oaas_decodes_to_the_published_motion(golden_file):
    golden, tokenizer = read(golden_file, "bad_oaas"), load_tokenizer(golden_file)
    *_, lengths, steps = sampled(golden_file, golden, "batch", ALL)
    motion = tokenizer.decode(steps[-1][2]).features
    expected = golden["batch.out.motion_first8dims"]
    torch.testing.assert_close(motion[..., :8], expected[:, : motion.shape[1]], **CLOSE)
    assert not expected[:, int(lengths.max()) * 4 :].any()


# Editing

TASKS = {"inbetween": "inbetween", "outpainting": "outpaint", "prefix": "prefix", "suffix": "suffix"}


@pytest.mark.parametrize("name", TASKS)
def test_kept_codes_of_the_editing_tasks(golden_file, name):
    """Encode the published slices, each by itself."""
    golden, tokenizer = read(golden_file, "bad_edit"), load_tokenizer(golden_file)
    tokens = golden["in.m_length"] // 4
    slots = task_slots(TASKS[name], tokens, 50)
    codes = torch.full_like(slots, -1, dtype=torch.long)
    for row, motion in enumerate(golden["in.motion"]):
        pieces = [motion[a:b] for a, b in task_slices(TASKS[name], int(tokens[row]))]
        encoded = [tokenizer.encode(MotionBatch(p[None], torch.tensor([len(p)]))).codes.flatten() for p in pieces]
        codes[row, slots[row]] = torch.cat(encoded)
    assert torch.equal(codes, golden[f"{name}.out.token_cond"])


@pytest.mark.parametrize("sampler", ["oaas", "cbs"])
@pytest.mark.parametrize("name", TASKS)
def test_editing(golden_file, name, sampler):
    golden, model = read(golden_file, "bad_edit"), load(golden_file)
    lengths = golden["in.m_length"] // 4
    given, orders = golden[f"{name}.out.token_cond"], golden[f"{name}.in.orders"]
    size = int(lengths.max())
    latents = Latents(lengths, lengths * 4, codes=given[:, :size, None].clamp(min=0))
    steps = model.trajectory(
        text(golden),
        None,
        seeds=torch.zeros(3, dtype=torch.long),
        known=Known(latents, given[:, :size] >= 0),
        sampling=BadSampling(sampler=sampler, temperature=0, official_inference_mask=True),
        draws=Recorded(orders),
    )
    *_, (_, _, result) = list(steps)
    assert torch.equal(ids_of(result.codes[..., 0], lengths, 50), golden[f"{name}.out.ids_{sampler}"])
    free = (given < 0) & frame_mask(lengths, 50)
    mask = hybrid_mask(orders, free, lengths, **model.rules)
    assert torch.equal(mask, golden[f"{name}.out.mask0"])
    if (name, sampler) == ("inbetween", "oaas"):
        motion = load_tokenizer(golden_file).decode(result).features
        torch.testing.assert_close(motion, golden["inbetween.out.motion"], **CLOSE)

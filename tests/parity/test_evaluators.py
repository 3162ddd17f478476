"""Both evaluators reproduce the published modules' embeddings and losses, and their weights go there and back."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from safetensors import safe_open

from kinema.evaluation.encoders.clip_style import ContrastiveEvaluator
from kinema.evaluation.encoders.t2m import MatchingEvaluator, margin_losses
from kinema.interop import clip_evaluator, load, t2m_evaluator
from kinema.motion.representation import Representation
from kinema.motion.statistics import Statistics
from kinema.types import Caption, MotionBatch

CLOSE = {"rtol": 1e-4, "atol": 3e-5}


def read(path):
    """Give a golden file's tensors and configuration."""
    with safe_open(path, "pt") as file:
        return {k: file.get_tensor(k) for k in file.keys()}, json.loads(file.metadata()["config"])  # noqa: SIM118


def state(golden, prefix="sd."):
    return {k.removeprefix(prefix): v for k, v in golden.items() if k.startswith(prefix)}


def unit_statistics(width):
    return Statistics(np.zeros(width), np.ones(width))


class Recorded:
    """Answer captions by recorded rows (the caption is the row's number)."""

    identity = "recorded"

    def __init__(self, golden):
        self.golden = golden

    def __call__(self, captions, device):
        rows = [int(c.text) for c in captions]
        return tuple(self.golden[k][rows] for k in ("in.word_emb", "in.pos_onehot", "in.cap_lens"))


def numbered(count):
    return [Caption(str(i)) for i in range(count)]


def batch_of(golden, lengths="in.m_lens"):
    motion = golden["in.motion"]
    return MotionBatch(motion, golden[lengths], captions=numbered(len(motion)))


@pytest.fixture
def mardm(golden_file):
    return read(golden_file("mardm/mardm_evaluators.safetensors"))[0]


@pytest.fixture
def original(golden_file):
    return read(golden_file("diffusion/t2meval_matching.safetensors"))[0]


def test_mardm_matching_embeddings(mardm):
    model = load("t2m-evaluator", state(mardm), statistics=unit_statistics(67), max_frames=40).attach(Recorded(mardm))
    batch = batch_of(mardm)
    torch.testing.assert_close(model.movements(batch), mardm["out.movement"], **CLOSE)
    order = mardm["out.align_idx"]
    motion, text = model.embed_motion(batch), model.embed_text(batch.captions)
    torch.testing.assert_close(motion[order], mardm["out.wrapper_motion_emb"], **CLOSE)
    torch.testing.assert_close(text[order], mardm["out.wrapper_text_emb"], **CLOSE)


@pytest.mark.parametrize("margin", [10.0, 3.0])
def test_original_matching_losses(original, margin):
    model = load_original(original, negative_shift="legacy", margin=margin)
    batch = batch_of(original)
    text, motion = model.embed_text(batch.captions), model.embed_motion(batch)
    torch.testing.assert_close(text, original["out.text_emb"], **CLOSE)
    torch.testing.assert_close(motion, original["out.motion_emb"], **CLOSE)
    order = original["out.length_order"]
    for shift, expected in enumerate(original[f"out.matching_loss_margin{margin:g}"]):
        found = margin_losses(text[order], motion[order], shift, margin)
        torch.testing.assert_close(torch.stack(list(found.values())), expected, rtol=1e-4, atol=3e-4)


def test_original_matching_gradients_through_the_legacy_draw(original):
    model = load_original(original, negative_shift="legacy").train().requires_grad_(True)
    drawn = next(s for s in range(100) if draw(s) == 2)
    model.loss(batch_of(original), generator=torch.Generator().manual_seed(drawn))["loss"].backward()
    for name in ("motion_encoder.hidden", "text_encoder.pos_emb.weight"):
        expected = original[f"out.grad_shift2.{name}"]
        torch.testing.assert_close(model.get_parameter(name).grad, expected, rtol=1e-3, atol=1e-4)


def draw(seed):
    return int(torch.randint(0, 4, (1,), generator=torch.Generator().manual_seed(seed)))


def load_original(golden, **options):
    options = {"statistics": unit_statistics(263), "variant": "raw", "max_frames": 40} | options
    return load("t2m-evaluator", state(golden), **options).attach(Recorded(golden))


def test_legacy_padding_reads_what_stands_past_the_end(original):
    batch = batch_of(original)
    batch.features = torch.where(batch.mask[..., None], batch.features, torch.tensor(1.7))
    leaking, masked = (load_original(original, padding=p).embed_motion(batch) for p in ("legacy", "masked"))
    torch.testing.assert_close(leaking, original["out.motion_emb_padding_1.7"], **CLOSE)
    torch.testing.assert_close(masked, original["out.motion_emb"], **CLOSE)


def test_decomposition_loss(golden_file):
    golden, _ = read(golden_file("diffusion/t2meval_decomposition.safetensors"))
    model = load("t2m-decomposition", state(golden), statistics=unit_statistics(263), variant="raw").eval()
    windows = golden["in.windows"]
    losses = model.loss(MotionBatch(windows, torch.full((len(windows),), windows.shape[1])))
    expected = {"loss": "loss", "reconstruction": "loss_rec", "sparsity": "loss_sparsity", "smoothness": "loss_smooth"}
    for ours, theirs in expected.items():
        torch.testing.assert_close(losses[ours], golden[f"out.{theirs}"], **CLOSE)
    codes = model.movement_encoder(windows[..., :-4])
    torch.testing.assert_close(codes, golden["out.latents"], rtol=1e-4, atol=4e-5)
    torch.testing.assert_close(model.movement_decoder(codes), golden["out.reconstruction"], **CLOSE)


@pytest.mark.parametrize("training", [False, True])
def test_contrastive_embeddings_and_loss(mardm, training):
    weights = state(mardm, "sd.contrast_model.")
    model = load("clip-evaluator", weights, statistics=unit_statistics(67), heads=4, dropout=0.0).train(training)
    model.attach(RecordedTokens(mardm["in.clip_tokens"], model.token_embedding))
    batch = batch_of(mardm)
    motion, text = model.embed_motion(batch), model.embed_text(batch.captions)
    torch.testing.assert_close(motion, mardm["out.wrapper_clip_motion"], **CLOSE)
    torch.testing.assert_close(text, mardm["out.wrapper_clip_text"], **CLOSE)
    logits = model.logit_scale.exp() * motion @ text.T
    torch.testing.assert_close(logits, mardm["out.logits_per_motion"], rtol=1e-4, atol=3e-4)
    torch.testing.assert_close(model.loss(batch)["loss"], mardm["out.contrastive_loss"], **CLOSE)


class RecordedTokens(SimpleNamespace):
    """Give recorded ids by the caption's number."""

    def __init__(self, ids, embedding):
        super().__init__(identity="recorded", ids=ids, embedding=embedding)

    def __call__(self, texts):
        return self.ids[[int(t) for t in texts]]

    def end_positions(self, ids):
        return ids.argmax(1)


@pytest.mark.parametrize(("kind", "skeleton", "drop"), [("essential", "kit", False), ("redundant", "humanml3d", True)])
def test_matching_weights_go_to_the_published_layout_and_back(kind, skeleton, drop):
    torch.manual_seed(3)
    sizes = {"movement_width": 12, "movement_dim": 10, "motion_hidden": 14, "text_hidden": 9, "embedding": 7}
    model = MatchingEvaluator(Representation(kind, skeleton), word_width=5, drop_contacts=drop, **sizes)
    back = load("t2m-evaluator", t2m_evaluator.export(model))
    assert_same_weights(model, back)
    assert (back.drop_contacts, back.spec["movement_width"]) == (drop, 12)


def test_contrastive_weights_go_to_the_published_layout_and_back():
    torch.manual_seed(4)
    sizes = {"token_width": 8, "width": 8, "layers": 3, "heads": 2, "feedforward": 20, "embedding": 6}
    model = ContrastiveEvaluator(Representation("essential", "kit"), vocabulary=11, context=77, **sizes)
    model.token_embedding.normal_()
    assert_same_weights(model, load("clip-evaluator", clip_evaluator.export(model), heads=2))


def assert_same_weights(model, back):
    ours = {k: v for k, v in model.state_dict().items() if not k.startswith("representation.")}
    theirs = {k: v for k, v in back.state_dict().items() if not k.startswith("representation.")}
    torch.testing.assert_close(ours, theirs, rtol=0, atol=0)


def test_a_foreign_state_dict_is_refused():
    with pytest.raises(ValueError, match=r"movement_encoder\.main\.0\.weight"):
        load("t2m-evaluator", {"movement_encoder": {"other": torch.zeros(1)}})

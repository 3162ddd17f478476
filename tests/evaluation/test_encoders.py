"""Evaluators embed a clip alike whatever its batch, train every weight, and refuse what they cannot read."""

from __future__ import annotations

import contextlib
from dataclasses import replace

import numpy as np
import pytest
import torch

from kinema.evaluation.encoders.base import caption_keys, false_negatives
from kinema.evaluation.encoders.t2m import DecompositionAutoencoder, draw_shift
from kinema.experiments.config import CONF, compose
from kinema.experiments.stages import get_stage
from kinema.motion.statistics import Statistics
from kinema.runs.build import build
from kinema.text.tokens import clip_tokens
from kinema.text.words import word_vectors
from kinema.types import Caption, MotionBatch

KINDS = ["matching", "contrastive"]
EVALUATORS = sorted(file.stem for file in (CONF / "evaluator").glob("*.yaml"))


def garbage(batch, extra):
    """Append frames and put garbage everywhere past the lengths."""
    features = torch.nn.functional.pad(batch.features, (0, 0, 0, extra))
    longer = replace(batch, features=features)
    longer.features = torch.where(longer.mask[..., None], features, torch.tensor(3.0))
    return longer


@pytest.mark.parametrize("kind", KINDS)
def test_a_clip_is_embedded_alike_alone_padded_and_in_any_order(make, kind):
    model = getattr(make, kind)().eval()
    batch = make.batch(lengths=[40, 16, 36, 24, 40, 8, 12, 20])
    expected = model.embed_motion(batch)
    torch.testing.assert_close(model.embed_motion(garbage(batch, 9)), expected, rtol=1e-5, atol=1e-5)
    for row, length in enumerate(batch.lengths.tolist()):
        alone = MotionBatch(batch.features[row : row + 1, :length], batch.lengths[row : row + 1])
        torch.testing.assert_close(model.embed_motion(alone)[0], expected[row], rtol=1e-5, atol=1e-5)
    order = torch.tensor([3, 1, 7, 0, 6, 2, 5, 4])
    shuffled = MotionBatch(batch.features[order], batch.lengths[order])
    torch.testing.assert_close(model.embed_motion(shuffled), expected[order], rtol=1e-5, atol=1e-5)
    captions = [batch.captions[i] for i in order]
    text = model.embed_text(batch.captions)
    torch.testing.assert_close(model.embed_text(captions), text[order], rtol=1e-5, atol=1e-5)


def test_legacy_padding_lets_garbage_in(make):
    model, batch = make.matching(padding="legacy").eval(), make.batch(lengths=[16] * 8)
    changed = (model.embed_motion(garbage(batch, 0)) - model.embed_motion(batch)).abs().amax(1)
    assert (changed > 1e-4).all()


@pytest.mark.parametrize("evaluator", EVALUATORS)
@pytest.mark.parametrize("stage", KINDS)
def test_no_judge_of_a_table_sees_what_else_is_in_a_batch(stage, evaluator, make):
    """Statistics are those of a corpus: zero before normalisation is a pose deep in the ground after it."""
    judge = build(get_stage(stage).spec(compose(["scale=smoke", f"evaluator={evaluator}"], "evaluate")))
    width = judge.representation.skeleton.feature_width
    rng = np.random.default_rng(3)
    judge.representation.fit(Statistics(rng.normal(size=width), 0.2 + rng.random(width)))
    batch = make.batch(lengths=[40, 16, 36, 24, 40, 8, 12, 20])
    together = judge.eval().embed_motion(batch)
    for row, length in enumerate(batch.lengths.tolist()):
        alone = MotionBatch(batch.features[row : row + 1, :length], batch.lengths[row : row + 1])
        torch.testing.assert_close(judge.embed_motion(alone)[0], together[row], rtol=1e-4, atol=1e-4)


def test_the_longest_clip_ends_as_in_the_published_input(make):
    model, batch = make.matching(max_frames=40).eval(), make.batch(lengths=[40, 36] * 4)
    published = model.movement_encoder(model.representation.normalize(batch.features, batch.lengths))
    torch.testing.assert_close(model.movements(batch), published, rtol=1e-5, atol=1e-6)
    with pytest.raises(ValueError, match="max_frames=36"):
        make.matching(max_frames=36).movements(batch)


OBJECTIVES = [("matching", {}), ("matching", {"objective": "infonce"}), ("contrastive", {})]


@pytest.mark.parametrize(("kind", "options"), OBJECTIVES)
def test_gradients_reach_every_trainable_weight_and_a_step_lowers_the_loss(make, kind, options):
    model, batch = getattr(make, kind)(**options).train(), make.batch()
    trainable = {k: p for k, p in model.named_parameters() if p.requires_grad}
    assert {k.split(".")[0] for k in trainable} >= {"motion_encoder", "text_encoder"}
    assert not any(k.startswith(("movement_encoder", "token")) for k in trainable)
    optimizer = torch.optim.SGD(trainable.values(), lr=1e-4)
    before = model.loss(batch, generator=torch.Generator().manual_seed(0))
    assert next(iter(before)) == "loss"
    before["loss"].backward()
    assert [k for k, p in trainable.items() if p.grad is None or not p.grad.abs().sum() > 0] == []
    optimizer.step()
    assert model.loss(batch, generator=torch.Generator().manual_seed(0))["loss"] < before["loss"]


@pytest.mark.parametrize("drop_contacts", [False, True])
def test_movements_are_pretrained_then_frozen(make, drop_contacts):
    representation = make.representation("redundant")
    stage = DecompositionAutoencoder(representation, width=12, latent_dim=10, drop_contacts=drop_contacts)
    windows = make.batch(lengths=[24] * 8, frames=24)
    losses = stage.loss(windows)
    losses["loss"].backward()
    assert all(p.grad.abs().sum() > 0 for p in stage.parameters())
    model = make.matching(representation=representation, drop_contacts=drop_contacts).load_movement(stage).train()
    assert not model.movement_encoder.training
    assert model.motion_encoder.training
    batch = make.batch()
    kept = model.movements(batch)
    assert torch.equal(model.movements(batch), kept)
    draws = [torch.Generator().manual_seed(5) for _ in range(2)]
    losses = [model.loss(batch, generator=draws[0]), model.loss(batch, generator=draws[1], movements=kept)]
    assert torch.equal(losses[0]["loss"], losses[1]["loss"])
    with pytest.raises(ValueError, match="train the decomposition stage anew"):
        make.matching(representation=make.representation()).load_movement(stage)


@pytest.mark.parametrize(("shift", "taken"), [(1e-7, True), (1e-2, False)])
def test_a_movement_encoder_of_another_machine_is_taken_and_one_of_another_corpus_is_not(make, shift, taken):
    trained, here = make.representation(), make.representation()
    here.mean += shift * here.std
    here.std *= 1 - shift
    stage = DecompositionAutoencoder(trained, width=12, latent_dim=10)
    with contextlib.nullcontext() if taken else pytest.raises(ValueError, match="train the decomposition stage anew"):
        make.matching(representation=here).load_movement(stage)


def test_negatives_are_never_their_own_positives_unless_asked_for():
    generator = torch.Generator().manual_seed(0)
    shifts = {rule: {draw_shift(5, rule, generator) for _ in range(200)} for rule in ("nonzero", "legacy")}
    assert shifts == {"nonzero": {1, 2, 3, 4}, "legacy": {0, 1, 2, 3}}
    with pytest.raises(ValueError, match="at least 2"):
        draw_shift(1, "nonzero", generator)


def test_captions_that_say_the_same_are_no_negatives(make):
    keys = caption_keys(["A man walks.", "a man  walks", "a man runs"], torch.device("cpu"))
    assert false_negatives(keys).nonzero().tolist() == [[0, 1], [1, 0]]
    batch = make.batch(size=4)
    twins = replace(batch, captions=[batch.captions[0]] * 4)
    # With all captions equal nothing is left to contrast with.
    assert make.matching(objective="infonce").loss(twins)["loss"] == 0
    assert make.contrastive(mask_duplicates=True).loss(twins)["loss"] == 0
    assert make.contrastive().loss(twins)["loss"] > 1


@pytest.mark.parametrize("kind", KINDS)
def test_a_vocabulary_is_required_remembered_and_not_saved(make, kind):
    model = getattr(make, kind)()
    model.embed_text([Caption("walk", ("walk/VERB",))])
    assert not any("embedding" in k for k in model.state_dict() if not k.startswith("text_encoder"))
    fresh = getattr(make, kind)()
    fresh.load_state_dict(model.state_dict())
    assert fresh.identity() == model.identity()
    fresh.__dict__["_attached"] = None
    with pytest.raises(ValueError, match="attach"):
        fresh.embed_text([Caption("walk", ("walk/VERB",))])
    other = clip_tokens("hashed") if kind == "contrastive" else word_vectors("hashed")
    object.__setattr__(other, "identity", "another")
    with pytest.raises(ValueError, match="trained with another vocabulary than 'another'"):
        fresh.attach(other).embed_text([Caption("walk", ("walk/VERB",))])


def test_an_evaluator_that_owns_its_tokens_embeds_as_one_that_borrows_them(make):
    borrowing, owning = make.contrastive().eval(), make.contrastive(vocabulary=1024).eval()
    captions = [make.caption(i) for i in range(3)]
    assert torch.equal(borrowing.embed_text(captions), owning.embed_text(captions))
    assert owning.state_dict()["token_embedding"].any()


@pytest.mark.parametrize("kind", KINDS)
def test_identity_follows_weights_statistics_and_behaviour(make, kind):
    model = getattr(make, kind)()
    named = {model.identity()}
    with torch.no_grad():
        next(model.motion_encoder.parameters()).add_(1)
    named.add(model.identity())
    model.representation.mean[0] += 1
    named.add(model.identity())
    assert len(named) == 3
    assert make.matching(padding="legacy").identity() != make.matching().identity()


def test_bad_inputs_are_named(make):
    model = make.matching(representation=make.representation("redundant"))
    with pytest.raises(ValueError, match="67 columns"):
        model.embed_motion(make.batch(width=67))
    with pytest.raises(ValueError, match="clip0-002 has 3 frames"):
        make.matching().embed_motion(make.batch(lengths=[8, 8, 3, 8, 8, 8, 8, 8]))
    with pytest.raises(ValueError, match=r"drop_contacts=True needs the redundant"):
        make.matching(drop_contacts=True)
    with pytest.raises(ValueError, match=r"MatchingEvaluator.padding=zero: must be one of masked, legacy"):
        make.matching(padding="zero")
    with pytest.raises(ValueError, match="set token_width=64"):
        make.contrastive(token_width=32)


@pytest.mark.parametrize("kind", KINDS)
def test_an_essential_evaluator_reads_either_width(make, kind):
    model, batch = getattr(make, kind)().eval(), make.batch()
    narrow = replace(batch, features=batch.features[..., :67])
    assert torch.equal(model.embed_motion(narrow), model.embed_motion(batch))

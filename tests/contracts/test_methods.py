"""What every method must do: learn, generate, edit, be saved, come back and give the same motion again."""

from __future__ import annotations

from copy import deepcopy
from functools import cache

import numpy as np
import pytest
import torch

from kinema.evaluation.sources import Edited
from kinema.experiments.config import CONF
from kinema.experiments.database import build_database
from kinema.experiments.stages import get_stage
from kinema.experiments.stages.fitted import FittedStage
from kinema.generators import Generator
from kinema.generators.remodiffuse import ReMoDiffuse
from kinema.pipeline import TextToMotion
from kinema.text.hashed import HashedTextEncoder
from kinema.types import Latents

METHODS = sorted(file.stem for file in (CONF / "method").glob("*.yaml"))
TEXTS = ["a person walks forward", "someone waves with the left hand", "a man jumps twice"]


class Few:
    """Hold the latents of a few clips."""

    def __init__(self, latents: Latents) -> None:
        self.rows = latents.content[latents.mask]

    def range(self) -> tuple[torch.Tensor, torch.Tensor]:
        return self.rows.amin(0), self.rows.amax(0)


@pytest.fixture(scope="session")
def make(workshop):
    """Give a method's parts: tokenizer, generator with its database if it has one, and what is trained to stand by."""

    @cache
    def made(method: str):
        if method == "motiongpt":
            pytest.importorskip("transformers", reason="needs the extra kinema[text]")
        choice = f"method={method}"
        tokenizer = workshop.tokenizer(choice)
        generator = workshop.make("generator", choice)
        names = [name for name in generator.parts if isinstance(get_stage(name), FittedStage)]
        names = [name for name in names if get_stage(name).present(workshop.cfg(choice))]
        beside = {name: workshop.make(name, choice) for name in names}
        with torch.no_grad():
            latents = tokenizer.encode(workshop.clips())
        for model in (generator, *beside.values()):
            if model.lacks_empty_text:
                model.take_empty_text(workshop.text.empty())
            model.prepare(tokenizer, Few(latents))
        if "shortcut" in beside:
            beside["shortcut"].learn_from(deepcopy(generator))
        if "retrieval" in generator.parts:
            database = build_database(workshop.store, workshop.text, tokenizer, max_frames=196)
            generator.attach("retrieval", database)
        return tokenizer, generator, beside

    return made


@pytest.fixture(scope="session")
def pipeline(make, workshop):
    """Give a method as a user holds it (untrained)."""

    def made(method: str) -> TextToMotion:
        tokenizer, generator, trained = make(method)
        beside = {name: part.eval() for name, part in trained.items()}
        if isinstance(generator, ReMoDiffuse):
            beside["retrieval"] = generator.database
        return TextToMotion(tokenizer, generator.eval(), workshop.text, beside, {"text": {"encoder": "hashed"}})

    return made


def in_time(model: TextToMotion) -> bool:
    return model.generator.space.unit is not None


@pytest.mark.parametrize("stage", ["generator", "residual", "shortcut"])
@pytest.mark.parametrize("method", METHODS)
def test_one_step_has_a_finite_loss_and_a_gradient_in_every_parameter(make, workshop, method, stage):
    tokenizer, generator, beside = make(method)
    model = {"generator": generator, **beside}.get(stage)
    if model is None:
        pytest.skip(f"{method} has no {stage}")
    assert stage != "generator" or isinstance(model, Generator)
    batch = workshop.clips(8)
    latents, text = tokenizer.encode(batch), workshop.text(batch.texts)
    text.clip_ids = batch.clip_ids
    model = deepcopy(model)
    with torch.no_grad():  # gates that start at zero would hide what they gate
        for parameter in model.parameters():
            parameter.add_(0.02 * torch.randn(parameter.shape, generator=torch.Generator().manual_seed(2)))
    before = {n: p.detach().clone() for n, p in model.named_parameters() if p.requires_grad}
    optimizer = torch.optim.SGD([p for p in model.parameters() if p.requires_grad], lr=1e-3)
    model.train()
    losses = model.loss(latents, text, generator=torch.Generator().manual_seed(1))
    assert next(iter(losses)) == "loss"
    assert all(value.isfinite() for value in losses.values())
    losses["loss"].backward()
    lacking = [n for n, p in model.named_parameters() if p.requires_grad and (p.grad is None or not p.grad.any())]
    assert not lacking
    optimizer.step()
    model.eval()
    assert any(not torch.equal(before[n], p) for n, p in model.named_parameters() if n in before)


@pytest.mark.parametrize("method", METHODS)
def test_it_generates_edits_is_saved_and_comes_back(pipeline, method, tmp_path):
    model = pipeline(method)
    frames = [40, 84, 62]
    motions = model.generate(TEXTS, frames, seed=3)
    assert [len(m.features) for m in motions] == frames
    assert all(np.isfinite(m.joints).all() for m in motions)
    if in_time(model):
        edited = model.edit(motions, TEXTS[0], "inbetween", seed=4)
        for motion, result in zip(motions, edited, strict=True):
            quarter = len(motion.features) // 4
            assert np.array_equal(result.features[:quarter], motion.features[:quarter])
            assert np.array_equal(result.features[-quarter:], motion.features[-quarter:])
    else:
        with pytest.raises(ValueError, match="keeping a part of a motion needs latents in time, but here 1 latents"):
            model.edit(motions, TEXTS[0], "inbetween", seed=4)
    model.save(tmp_path / "saved")
    again = TextToMotion.from_run(tmp_path / "saved", device="cpu")
    for first, second in zip(motions, again.generate(TEXTS, frames, seed=3), strict=True):
        np.testing.assert_array_equal(first.features, second.features)


@pytest.mark.parametrize("method", METHODS)
def test_a_text_encoder_of_another_width_is_refused(make, method):
    tokenizer, generator, _ = make(method)
    if method == "motiongpt":  # reads the words themselves
        assert (generator.text_dim, generator.token_dim) == (None, None)
        return
    with pytest.raises(ValueError, match=r"the generator reads text .* of 64 numbers, hashed-32 makes them of 32"):
        TextToMotion(tokenizer, generator, HashedTextEncoder(dim=32))


@pytest.mark.parametrize("method", METHODS)
def test_a_motion_depends_on_its_own_seed_and_text_alone(pipeline, method):
    model = pipeline(method)
    motions = model.generate(TEXTS, [40, 84, 62], seed=3)
    reversed_ = [
        model.generate(text, len(motion.features), seed=motion.seed)[0]
        for text, motion in reversed(list(zip(TEXTS, motions, strict=True)))
    ]
    for motion, alone in zip(motions, reversed(reversed_), strict=True):
        np.testing.assert_allclose(alone.features, motion.features, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("method", METHODS)
def test_without_a_length_it_ends_itself_or_says_what_is_missing(pipeline, workshop, method):
    model = pipeline(method)
    if (
        model.generator.space.unit is None
    ):  # of a whole motion's latents nothing tells how long motion may be but its crops
        assert model.max_frames == model.skeleton.max_frames // 4 * 4 - 4
    declared = workshop.cfg(f"method={method}").generator.get("predicts_length", False)
    assert declared == model.generator.predicts_length
    if not model.generator.predicts_length:
        with pytest.raises(ValueError, match="no length: give frames="):
            model.generate(TEXTS[:2], seed=1)
        return
    for motion in model.generate(TEXTS[:2], seed=1):
        assert 4 <= len(motion.features) <= model.max_frames


@pytest.mark.parametrize("method", METHODS)
def test_parts_are_chained_to_a_long_motion(pipeline, method):
    model = pipeline(method)
    if not in_time(model):
        with pytest.raises(ValueError, match="joining motions needs latents in time, but here 1 latents"):
            model.chain(TEXTS, [100, 120, 40], seed=2)
        return
    motion = model.chain(TEXTS, [100, 120, 40], seed=2)
    assert len(motion.features) == 100 + 120 + 40 + 2 * 8
    assert np.isfinite(motion.joints).all()
    with pytest.raises(ValueError, match=f"a transition of {model.max_frames} frames does not fit"):
        model.chain(TEXTS, 40, seed=2, transition=model.max_frames)


@pytest.mark.parametrize("method", METHODS)
def test_products_in_bfloat16_give_nearly_the_same_motion_and_are_not_saved(make, workshop, method, tmp_path):
    tokenizer, generator, trained = make(method)
    beside = {name: deepcopy(part).eval() for name, part in trained.items()}
    if isinstance(generator, ReMoDiffuse):
        beside["retrieval"] = generator.database
    model = TextToMotion(deepcopy(tokenizer), deepcopy(generator).eval(), workshop.text, beside)
    if tokenizer.placed:
        with pytest.raises(ValueError, match="bfloat16 rounds places in space to centimetres"):
            model.bfloat16()
        return
    whole = model.generate(TEXTS, [40, 84, 62], seed=3)
    short = model.bfloat16().generate(TEXTS, [40, 84, 62], seed=3)
    assert all(motion.features.dtype == np.float32 and np.isfinite(motion.joints).all() for motion in short)
    if generator.space.kind != "codes":  # another code than before is another motion from there on
        for one, other in zip(whole, short, strict=True):
            assert np.abs(one.features - other.features).mean() < 0.1 * one.features.std()
    clips = workshop.clips(3)
    if in_time(model):  # as tables score an edit: parts are called by themselves
        edited = Edited(model, task="prefix")(clips, torch.arange(3))
        assert edited.features.isfinite().all()
    with pytest.raises(ValueError, match="weights were cast to bfloat16; load it again"):
        model.save(tmp_path / "saved")

"""What is wrong is told before anything trains, and leaves no run folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from kinema.experiments import training
from kinema.experiments.config import compose
from kinema.experiments.evaluation import describe, run_evaluation
from kinema.experiments.run import run_stage
from kinema.runs import weights
from kinema.runs.build import build
from kinema.runs.folder import RunFolder
from kinema.types import MotionBatch

UNMARKED = "no class that is marked @buildable"
WRONG = [
    ("train", ["generator.model._target_=kinema.generators.mar.MARDMX"], UNMARKED),
    ("train", ["generator.sampling._target_=kinema.runs.weights.Path"], UNMARKED),
    ("train", ["tokenizer.model._target_=os.system"], UNMARKED),
    ("train", ["length.model._target_=kinema.nope.X"], UNMARKED),
    ("train", ["text=clip_b32", "text.path=/nowhere"], "no CLIP model at '/nowhere'"),
    ("train", ["text=minilm", "text.path=/nowhere"], "/nowhere"),
    ("train", ["text.dim=63"], "text.dim=63, and hashed-64 gives 64 numbers"),
    ("evaluate", ["text=clip_b32", "text.path=/nowhere"], "no CLIP model at '/nowhere'"),
    ("evaluate", ["source=nearest", "text=clip_b32", "text.path=/nowhere"], "no CLIP model at '/nowhere'"),
    ("evaluate", ["generator.sampling._target_=kinema.generators.mar.X"], UNMARKED),
    ("evaluate", ["evaluator.matching.model._target_=kinema.X"], UNMARKED),
    ("evaluate", ["evaluator.decomposition.model._target_=kinema.X"], UNMARKED),
    ("evaluate", ["evaluator.words=nope"], "evaluator.words=nope: must be one of"),
    ("evaluate", ["evaluator.tokens=nope"], "evaluator.tokens=nope: must be one of"),
    ("evaluate", ["evaluator.words=our_vab", "evaluator.words_path=/nowhere"], "/nowhere"),
    ("evaluate", ["source=real", "evaluator.tokens=clip_b16", "evaluator.tokens_path=/nowhere"], "/nowhere"),
]


@pytest.fixture(autouse=True)
def nothing_trains(monkeypatch):
    monkeypatch.setattr(training, "fit", lambda *_, **__: pytest.fail("something was trained"))


def refused(cfg, what):
    with pytest.raises((ValueError, OSError)) as told:
        run_stage(cfg, "generator") if what == "train" else run_evaluation(cfg)
    assert not Path(cfg.paths.runs).exists() or not list(Path(cfg.paths.runs).rglob("config.yaml"))
    return str(told.value)


@pytest.mark.parametrize(("what", "changes", "message"), WRONG, ids=lambda value: str(value))
def test_what_is_wrong_is_told_before_anything_trains(overrides, what, changes, message):
    own = [o for o in overrides if o.split("=")[0] not in {c.split("=")[0] for c in changes}]
    assert message in refused(compose([*own, *changes], what), what)


@pytest.fixture
def momask(tmp_path, overrides) -> Path:
    """Give the folder of a MoMask generator, as an import leaves it."""
    spec = training.plain(compose([*overrides, "method=momask"]).generator.model)
    spec["sampling"] = training.plain(compose([*overrides, "method=momask"]).generator.sampling)
    weights.save(build(spec), spec, RunFolder(tmp_path / "imported").weights, part="generator")
    return tmp_path / "imported"


def test_a_run_of_another_method_is_told_with_the_method_to_add(overrides, momask):
    cfg = compose([*overrides, f"run={momask}"], "evaluate")
    with pytest.raises(ValueError, match=r"is of MoMask, .*method=mardm_sit \(MARDM\); add the method="):
        describe(cfg)
    (momask / "config.yaml").write_text("method: {name: momask_essential}\n")
    with pytest.raises(ValueError, match="add method=momask_essential"):
        describe(cfg)


@pytest.mark.parametrize("key", ["t2m", "clip"])
def test_a_judge_that_is_another_run_is_told_before_the_generator_trains(overrides, momask, key):
    cfg = compose([*overrides, f"evaluators.{key}={momask}"], "evaluate")
    assert "holds a run of 'generator'; give the folder of a" in refused(cfg, "evaluate")


def test_a_given_tokenizer_is_only_read(overrides, tmp_path, monkeypatch):
    """Its latents and their lock lie in the cache where the user may not write beside it."""
    cfg = compose([*overrides, f"paths.cache={tmp_path}/cache"])
    run = RunFolder(tmp_path / "theirs")
    run.path.mkdir()
    assert training._latents_of(cfg, run, "0123456789ab") == run.path / "latents-0123456789ab"
    monkeypatch.setattr("os.access", lambda *_: False)
    place = training._latents_of(cfg, run, "0123456789ab")
    assert place.is_relative_to(tmp_path / "cache" / "latents")
    (run.path / "latents-0123456789ab").mkdir()  # its owner's, whole: nothing is to be written
    assert training._latents_of(cfg, run, "0123456789ab") == run.path / "latents-0123456789ab"


@pytest.mark.parametrize("method", ["mardm_sit", "mmm", "momask", "mld"])
def test_a_tokenizer_takes_double_numbers(overrides, method):
    spec = training.plain(compose([*overrides, f"method={method}"]).tokenizer.model)
    tokenizer = build(spec).eval()
    for part in tokenizer.modules():
        if isinstance(part, training.Representation):
            part.mean.zero_()
            part.std.fill_(1)
    features = torch.from_numpy(np.random.default_rng(0).normal(size=(1, 24, 263)))
    double, single = (
        tokenizer.encode(MotionBatch(values, torch.tensor([24]))).content for values in (features, features.float())
    )
    assert torch.equal(double, single)

"""A shortcut's run: made after its generator's, opened as it, scored beside it, and the same however it was made."""

from __future__ import annotations

import pytest
import torch
from safetensors.torch import load_file

from kinema.experiments.config import compose
from kinema.experiments.evaluation import describe
from kinema.experiments.run import run_stage
from kinema.experiments.sampling import sampling_spec
from kinema.generators.frames.sampling import FrameSampling
from kinema.generators.msflow import ShortcutSampling
from kinema.pipeline import TextToMotion
from kinema.runs.parts import upstream
from kinema.training import fit as fitting

METHOD = "method=msflow_67_few"


@pytest.fixture
def overrides(overrides) -> list[str]:
    """Give a micro run of a method whose tokenizer has nothing to train, and whose network no dropout."""
    kept = [o for o in overrides if not o.startswith("tokenizer.train") and "dropout" not in o]
    kept += ["generator.train.steps=4", "generator.train.validate_every=4"]
    every = {"steps": 8, "warmup": 0, "validate_every": 4, "checkpoint_every": 3, "val_batches": 1}
    return [*kept, *(f"shortcut.train.{name}={value}" for name, value in every.items())]


def test_it_needs_a_generator_that_others_have_too_and_completes_it(overrides):
    shared = [o for o in overrides if not o.startswith("shortcut.")]
    few, whole = compose([*overrides, METHOD], "evaluate"), compose([*shared, "method=msflow_67"], "evaluate")
    rows = describe(few), describe(whole)
    assert rows[0].subject == rows[1].subject
    assert rows[0].beside["shortcut"] is not None
    assert rows[1].beside["shortcut"] is None
    assert rows[0].folder.path != rows[1].folder.path
    assert sampling_spec(few)["_target_"].endswith("ShortcutSampling")
    assert sampling_spec(whole) == sampling_spec(compose([*shared, "method=msflow_67"]))
    other = compose([*overrides, METHOD, "generator.train.lr=1e-5"], "evaluate")
    assert describe(other).beside["shortcut"] != rows[0].beside["shortcut"]
    two = compose([*overrides, METHOD, "shortcut.sampling.steps=2"], "evaluate")
    assert describe(two).runs == rows[0].runs
    assert describe(two).folder.path != rows[0].folder.path


def test_a_generator_that_is_named_stands_without_it(overrides):
    cfg = compose([*overrides, METHOD, "run=somewhere"], "evaluate")
    assert sampling_spec(cfg)["_target_"].endswith("FrameSampling")


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("diffusion.process.prediction=velocity", r"must be a Flow with prediction x1"),
        ("shortcut.model.grid=late", r"shortcut\.model\.grid=late: must be one of uniform, emergence"),
        ("shortcut.sampling.steps=3", r"3 steps are not of a grid of 8"),
        ("shortcut.model.finest=6", r"shortcut\.model\.finest=6: must be 2 or 4"),
    ],
)
def test_what_does_not_fit_is_told_before_anything_trains(override, message, overrides, tmp_path):
    with pytest.raises(ValueError, match=message):
        run_stage(compose([*overrides, METHOD, override]), "shortcut")
    assert not list((tmp_path / "runs").glob("*/*/weights.safetensors"))


@pytest.mark.slow
def test_it_is_opened_as_its_generator_and_resumes_to_the_same_weights(overrides, tmp_path, monkeypatch):
    cfg = compose([*overrides, METHOD])
    run = run_stage(cfg, "shortcut")
    assert set(upstream(run.path)) == {"tokenizer", "generator"}
    model = TextToMotion.from_run(run.path, device="cpu")
    assert model.generator.sampling == ShortcutSampling(steps=4, holding="projection", renewal=0.5)
    alone = TextToMotion.from_run(upstream(run.path)["generator"], device="cpu")
    assert type(alone.generator.sampling) is FrameSampling
    named = describe(compose([*overrides, METHOD, f"run={run.path}"], "evaluate"))  # as `kinema evaluate run=` says it
    assert named.beside["shortcut"].resolve() == run.path.resolve()
    assert named.subject["generator"].resolve() == upstream(run.path)["generator"].resolve()
    both = TextToMotion.from_run(upstream(run.path)["generator"], device="cpu", shortcut=run.path)
    first, second = (m.generate("a person walks", 40, seed=1)[0] for m in (model, both))
    assert (first.features == second.features).all()

    class Dying(fitting.Checkpoints):
        def on_train_batch_end(self, trainer, *rest):
            super().on_train_batch_end(trainer, *rest)
            if trainer.global_step == 5:
                raise OSError("no power")

    weights = load_file(run.weights)
    run.weights.rename(tmp_path / "kept.safetensors")
    run.mark("failed")
    with monkeypatch.context() as patch:
        patch.setattr(fitting, "Checkpoints", Dying)
        with pytest.raises(OSError, match="no power"):
            run_stage(cfg, "shortcut")
    again = load_file(run_stage(cfg, "shortcut").weights)
    assert weights.keys() == again.keys()
    assert all(torch.equal(weights[name], again[name]) for name in weights)


@pytest.mark.slow
def test_two_processes_train_like_one(overrides, script, tmp_path):
    cfg = compose([*overrides, METHOD])
    alone = run_stage(cfg, "shortcut")
    kept = tmp_path / "alone.safetensors"
    alone.weights.rename(kept)
    alone.mark("failed")
    script("train.py", METHOD, "trainer.devices=2", "trainer.strategy=ddp", "stage=shortcut")
    ours, theirs = load_file(alone.weights), load_file(kept)
    for name, value in theirs.items():
        torch.testing.assert_close(ours[name], value, rtol=1e-2, atol=1e-4, msg=name)

"""What is wrong is told before anything trains, and leaves no run folder."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from filelock import FileLock

from kinema.atomic import write_json
from kinema.data.store import PackedStore
from kinema.experiments import evaluation, training
from kinema.experiments.config import compose
from kinema.experiments.corpus import open_corpus
from kinema.experiments.evaluation import describe, run_evaluation
from kinema.experiments.run import run_stage
from kinema.experiments.stages import get_stage
from kinema.motion.representation import Representation
from kinema.runs import weights
from kinema.runs.build import build
from kinema.runs.consent import ask
from kinema.runs.folder import RunFolder
from kinema.training import latents
from kinema.types import MotionBatch

UNMARKED = "no class that is marked @buildable"
WRONG = [
    ("train", ["generator.model._target_=kinema.generators.mar.MARDMX"], UNMARKED),
    ("train", ["generator.sampling._target_=kinema.runs.weights.Path"], UNMARKED),
    ("train", ["tokenizer.model._target_=os.system"], UNMARKED),
    ("train", ["length.model._target_=kinema.nope.X"], UNMARKED),
    ("train", ["text=clip_b32", "text.path=/nowhere"], "no CLIP model at '/nowhere'"),
    ("train", ["text=minilm", "text.path=/nowhere"], "/nowhere"),
    ("train", ["method=mld", "diffusion.sampling.clip_latents=true"], "clip_latents=true isn't read by method=mld"),
    ("train", ["trainer.precision=bf16-true"], "must be one of 32-true, 16-mixed, bf16-mixed"),
    ("train", ["text.dim=63"], "text.dim=63, and hashed-64 gives 64 numbers"),
    ("evaluate", ["text=clip_b32", "text.path=/nowhere"], "no CLIP model at '/nowhere'"),
    ("evaluate", ["source=nearest", "text=clip_b32", "text.path=/nowhere"], "no CLIP model at '/nowhere'"),
    ("evaluate", ["generator.sampling._target_=kinema.generators.mar.X"], UNMARKED),
    ("evaluate", ["evaluator.matching.model._target_=kinema.X"], UNMARKED),
    ("evaluate", ["evaluator.decomposition.model._target_=kinema.X"], UNMARKED),
    ("evaluate", ["evaluator.words=nope"], "evaluator.words=nope: must be one of"),
    ("evaluate", ["evaluator.tokens=nope"], "evaluator.tokens=nope: must be one of"),
    ("evaluate", ["evaluator.words=our_vab", "evaluator.words_path=/nowhere"], "/nowhere"),
    ("evaluate", ["source=real", "precision=bfloat16"], "source=real has none; leave it out"),
    ("evaluate", ["precision=bf16"], "must be one of float32, bfloat16"),
    ("evaluate", ["task=editing", "keep_motions=true"], "keep_motions=true with task=editing"),
    ("evaluate", ["task=editing", "lengths=predicted"], "lengths=predicted with task=editing"),
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

    (momask / "config.yaml").write_text("a: &a [1, 1]\nb: [*a, *a]\n")
    with pytest.raises(ValueError, match=r"config\.yaml has an alias"):
        describe(cfg)


def test_a_given_run_reads_its_own_text_encoder(overrides, momask, tmp_path):
    given = [*overrides, "method=momask", f"run={momask}"]
    write_json(momask / "text.json", {"encoder": "hashed", "path": None})
    one, other = (compose([*given, *more], "evaluate") for more in ([], ["text.path=/nowhere"]))
    assert describe(one).folder.path == describe(other).folder.path
    evaluation.check_reads(other, describe(other))
    ask(momask, "text", str(tmp_path / "gone"))
    write_json(momask / "text.json", {"encoder": "minilm", "path": str(tmp_path / "gone")})
    with pytest.raises(FileNotFoundError, match="no MiniLM model"):
        evaluation.check_reads(one, describe(one))


def test_what_no_judge_of_a_row_reads_is_not_looked_for(overrides):
    own = [o for o in overrides if not o.startswith("evaluator.tokens")]
    row = [*own, "evaluator=redundant", "evaluator.tokens=clip_b16", "evaluator.tokens_path=/nowhere", "source=real"]
    cfg = compose(row, "evaluate")
    evaluation.check_reads(cfg, describe(cfg))
    whole = compose([*row, "evaluator.unread=[]"], "evaluate")
    with pytest.raises(FileNotFoundError, match="/nowhere"):
        evaluation.check_reads(whole, describe(whole))


@pytest.mark.parametrize("key", ["t2m", "clip"])
def test_a_judge_that_is_another_run_is_told_before_the_generator_trains(overrides, momask, key):
    cfg = compose([*overrides, f"evaluators.{key}={momask}"], "evaluate")
    assert "holds a run of 'generator'; give the folder of a" in refused(cfg, "evaluate")


@pytest.fixture
def theirs(overrides, tmp_path, monkeypatch) -> Callable[..., tuple[training.LatentCache, Path]]:
    """Give a tokenizer's run of somebody else's, read by a generator: returns its latents, and where they lie."""
    cfg = compose([*overrides, f"paths.cache={tmp_path}/cache"])
    store = PackedStore.open(open_corpus(cfg))
    run = RunFolder(tmp_path / "theirs" / "tokenizer-0123456789ab")
    tokenizer, spec = training.initial_model(get_stage("tokenizer"), cfg, store)
    weights.save(tokenizer, spec, run.weights, part="tokenizer")
    (run.path / "config.yaml").touch()

    def read(*, may_write: bool) -> tuple[training.LatentCache, Path]:
        model, _ = training.initial_model(get_stage("generator"), cfg, store)
        recipe = training.make_recipe(training.plain(cfg.generator.train), store)
        with monkeypatch.context() as patch:
            if not may_write:  # who runs the tests may be root, whom no permission stops
                forbid(patch, run.path)
            found = training.generator_module(cfg, model, recipe, store, run).latents.value
        return found, Path(found.values.base.filename).parent

    return read


def forbid(patch: pytest.MonkeyPatch, folder: Path) -> None:
    """Refuse to write into a folder, as the system does: when asked whether it may, and where it is tried."""
    access, acquire, new = os.access, FileLock.acquire, latents.new_folder

    def inside(path):
        return Path(path).is_relative_to(folder)

    def locked(self, *arguments, **options):
        if inside(self.lock_file):
            raise PermissionError(errno.EACCES, "Permission denied")
        return acquire(self, *arguments, **options)

    def made(path, **options):
        if inside(path):
            raise PermissionError(errno.EACCES, "Permission denied")
        return new(path, **options)

    patch.setattr(os, "access", lambda path, mode: access(path, mode) and not (inside(path) and mode & os.W_OK))
    patch.setattr(FileLock, "acquire", locked)
    patch.setattr(latents, "new_folder", made)


def test_a_tokenizer_that_may_only_be_read_is_trained_on(theirs, tmp_path):
    """Its whole latents are read as they are, without a lock; what isn't whole is made in the user's own cache."""
    own = tmp_path / "cache" / "latents"
    found, place = theirs(may_write=False)
    assert place.is_relative_to(own)
    made, shared = theirs(may_write=True)
    assert shared.is_relative_to(tmp_path / "theirs")
    assert np.array_equal(found.values, made.values)
    shutil.rmtree(own)
    before = sorted(tmp_path.glob("theirs/**/*"))
    assert theirs(may_write=False)[1] == shared
    assert not own.exists()
    for damaged in ("offsets.npy", "meta.json"):
        (shared / damaged).write_bytes(b"")
        found, place = theirs(may_write=False)
        assert place.is_relative_to(own)
        assert np.array_equal(found.values, made.values)
    assert sorted(tmp_path.glob("theirs/**/*")) == before


@pytest.mark.parametrize("method", ["mardm_sit", "mmm", "momask", "mld"])
def test_a_tokenizer_takes_double_numbers(overrides, method):
    spec = training.plain(compose([*overrides, f"method={method}"]).tokenizer.model)
    tokenizer = build(spec).eval()
    for part in tokenizer.modules():
        if isinstance(part, Representation):
            part.mean.zero_()
            part.std.fill_(1)
    features = torch.from_numpy(np.random.default_rng(0).normal(size=(1, 24, 263)))
    double, single = (
        tokenizer.encode(MotionBatch(values, torch.tensor([24]))).content for values in (features, features.float())
    )
    assert torch.equal(double, single)

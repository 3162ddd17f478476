"""A run's name changes with all that can change its result, and with nothing else."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from kinema.data.synthetic import synthetic_clips, write_joints_folder
from kinema.experiments import identity
from kinema.experiments.config import compose
from kinema.experiments.evaluation import describe
from kinema.experiments.identity import fingerprint, run_identity, stage_identity
from kinema.experiments.run import stage_folder
from kinema.experiments.stages import get_stage, stages

METHOD_OF = {"residual": "momask", "retrieval": "remodiffuse", "shortcut": "msflow_67_few"}
"""A method that has the stage, where the default has not."""
UNTRAINED = ("retrieval", "shortcut")
"""Stages of a method whose tokenizer has nothing to train."""


def named(stage: str, *overrides: str, corpus: str = "corpus") -> str:
    own = [f"method={METHOD_OF[stage]}"] if stage in METHOD_OF else []
    return fingerprint(stage_identity(compose([*own, *overrides]), get_stage(stage), lambda _: corpus))


@pytest.fixture(scope="module")
def plain_names() -> dict[str, str]:
    return {stage: named(stage) for stage in stages()}


def test_every_stage_has_its_own_name_that_does_not_change(plain_names):
    assert len(set(plain_names.values())) == len(stages())
    assert plain_names["generator"] == named("generator")


@pytest.mark.parametrize(
    ("stage", "override"),
    [
        ("generator", "seed=1"),
        ("generator", "generator.model.width=128"),
        ("generator", "generator.train.lr=1e-4"),
        ("generator", "generator.train.steps=401"),
        ("generator", "generator.train.ema=0.9"),
        ("generator", "method=mardm_ddpm"),
        ("generator", "representation=redundant"),  # through its tokenizer
        ("generator", "tokenizer.model.width=64"),  # the same
        ("generator", "tokenizer.train.steps=701"),
        ("generator", "text=hashed"),
        ("generator", "scale=tiny"),
        ("generator", "trainer.precision=bf16-mixed"),
        ("generator", "debug=steps"),
        ("tokenizer", "seed=1"),
        ("tokenizer", "representation=redundant"),
        ("tokenizer", "representation.variant=published"),
        ("matching", "evaluator=redundant"),
        ("matching", "evaluator.seed=1"),
        ("matching", "evaluator.words=hashed"),
        ("matching", "evaluator.decomposition.train.steps=201"),
        ("matching", "evaluator.matching.train.validate_every=50"),  # it keeps the best of the validated weights
        ("matching", "evaluator.matching.train.val_batches=2"),
        ("contrastive", "evaluator.tokens=hashed"),
        ("length", "text=hashed"),
    ],
)
def test_what_changes_the_result_changes_the_name(stage, override, plain_names):
    assert named(stage, override) != plain_names[stage]


@pytest.mark.parametrize("stage", stages())
def test_another_corpus_is_another_run(stage, plain_names):
    assert named(stage, corpus="other") != plain_names[stage]


MACHINE = [
    "trainer.accelerator=gpu",
    "trainer.devices=8",
    "trainer.num_nodes=2",
    "trainer.strategy=ddp",
    "trainer.compile=true",
    "trainer.progress=none",
    "trainer.log_every=1",
    "data.workers=7",
    "logger=wandb",
    "logger.group=mine",
    "logger.artifacts=true",
    "callbacks.samples_every=3",
    "callbacks.score_every=3",
    "callbacks.score_clips=64",
    "paths.runs=elsewhere",
    "paths.stores=elsewhere",
    "paths.cache=elsewhere",
    "ensure=false",
    "launcher=joblib",
    "scale.protocol.replications=9",
    "generator.sampling.temperature=0.9",
    *(f"{node}.train.checkpoint_every=7" for node in ("tokenizer", "generator", "length")),
    *(f"evaluator.{node}.train.checkpoint_every=7" for node in ("decomposition", "matching", "contrastive")),
    "generator.train.validate_every=7",
    "generator.train.val_batches=1",
]


@pytest.mark.parametrize("stage", stages())
def test_machine_and_bookkeeping_change_nothing(stage, plain_names):
    fits = [o for o in MACHINE if stage not in UNTRAINED or not o.startswith("tokenizer.train")]
    assert named(stage, *fits) == plain_names[stage]


BY_FID = ["method=momask", "generator.train.select=fid", "callbacks.score_every=5"]


@pytest.mark.parametrize(
    "override",
    [
        "generator.train.select=last",
        "callbacks.score_every=9",
        "callbacks.score_clips=64",
        "generator.sampling.temperature=0.9",
        "evaluator=redundant",
        "evaluator.matching.train.lr=1",
        "evaluator.decomposition.train.steps=201",
        "residual.train.steps=301",
        "scale.protocol.pool=8",
    ],
)
def test_what_chooses_the_weights_is_part_of_the_name(override):
    assert named("generator", *BY_FID, override) != named("generator", *BY_FID)


def test_what_chooses_nothing_is_not_part_of_the_name():
    observing = ["generator.train.validate_every=7", "callbacks.samples_every=3", "evaluator.contrastive.train.lr=1"]
    assert named("generator", *BY_FID, *observing, "scale.protocol.replications=9") == named("generator", *BY_FID)


@pytest.mark.parametrize(
    ("stage", "override"),
    [
        ("tokenizer", "text=hashed"),
        ("tokenizer", "generator.model.width=128"),
        ("tokenizer", "method=mardm_ddpm"),
        ("matching", "representation=redundant"),
        ("matching", "tokenizer.model.width=64"),
        ("matching", "seed=1"),  # methods of all seeds have the same judges
        ("length", "generator.model.width=128"),
    ],
)
def test_what_another_stage_reads_is_not_ones_own(stage, override, plain_names):
    assert named(stage, override) == plain_names[stage]


def test_methods_and_judges_learn_from_the_splits_they_name():
    def read(stage: str, *overrides: str) -> list[str | None]:
        cfg = compose(["data=open_mocap", *overrides])
        seen: list[str | None] = []
        stage_identity(cfg, get_stage(stage), lambda one: str(seen.append(one.split(cfg))))
        return seen

    divided = "data.options.split=compositional"
    assert read("generator", divided) == ["compositional"] * 2
    assert read("matching", divided) == [None] * 2
    assert read("matching", "evaluator.split=compositional") == ["compositional"] * 2


def test_a_new_meaning_of_configs_makes_new_runs(monkeypatch, plain_names):
    monkeypatch.setattr(identity, "IDENTITY_VERSION", identity.IDENTITY_VERSION + 1)
    assert named("generator") != plain_names["generator"]


def test_evaluations_have_an_identity_too(micro):
    def row(*overrides: str) -> str:
        return describe(compose([*micro, *overrides], "evaluate")).folder.path.name

    plain = row()
    for override in ("generator.sampling.guidance=1.5", "scale.protocol.pool=4", "source=real", "seed=1"):
        assert row(override) != plain, override
    for override in ("scale.protocol.replications=9", "trainer=default", "data.workers=2", "logger=none"):
        assert row(override) == plain, override
    # Real motion is the same whoever generates beside it.
    assert row("source=real", "method=mardm_ddpm") == row("source=real")


def test_a_row_is_another_where_labels_or_takes_are_others(tmp_path):
    """Oracles, breakdowns and what counts as memorised rest on them; what is trained doesn't."""
    corpus = write_joints_folder(synthetic_clips(size=40, seed=2), tmp_path / "corpus")
    asked = ["data=custom", f"data.source={corpus}", f"paths.stores={tmp_path}/stores", f"paths.runs={tmp_path}/runs"]

    def names() -> tuple[str, str]:
        row = describe(compose([*asked, "source=real"], "evaluate"))
        return row.folder.path.name, row.runs["matching"].name

    (corpus / "manifest.json").unlink(missing_ok=True)
    found = [names()]
    clips = sorted(file.stem for file in (corpus / "joints").iterdir())
    for style in ("happy", "sad"):
        (corpus / "manifest.json").write_text(json.dumps([{"name": name, "label": style} for name in clips]))
        found.append(names())
    assert len({row for row, _ in found}) == 3
    assert len({run for _, run in found}) == 1


def folder(stage: str, *overrides: str) -> Path:
    return stage_folder(compose(list(overrides)), get_stage(stage), lambda _: "corpus").path


@pytest.mark.parametrize(
    ("stage", "overrides", "label"),
    [
        ("generator", [], "mardm_sit-xl-essential-synthetic-smoke-s0-"),
        ("generator", ["generator=mar_s", "method=mardm_ddpm"], "mardm_ddpm-s-essential-synthetic-smoke-s0-"),
        ("generator", ["method=bad_cbs", "generator=bad_notime"], "bad-notime-published-synthetic-smoke-s0-"),
        ("generator", ["method=momask", "representation=redundant"], "momask-redundant-synthetic-smoke-s0-"),
        ("generator", ["scale=tiny", "seed=3", "data=synthetic_kit"], "mardm_sit-xl-essential-synthetic_kit-tiny-s3-"),
        ("tokenizer", ["debug=steps"], "ae-essential-synthetic-smoke-debug-s0-"),
        ("residual", ["method=momask"], "momask_residual-published-synthetic-smoke-s0-"),
        ("generator", ["method=msflow_67_few"], "msflow_67-essential-synthetic-smoke-s0-"),
        ("shortcut", ["method=msflow_67_few"], "msflow_67_few-essential-synthetic-smoke-s0-"),
        ("matching", ["evaluator=redundant"], "evaluator_redundant-redundant-synthetic-smoke-s0-"),
        ("length", [], "length-synthetic-smoke-s0-"),
    ],
)
def test_a_name_says_what_a_run_is(stage, overrides, label):
    assert folder(stage, *overrides).name.startswith(label)


def test_an_evaluation_says_whose_it_is(micro):
    name = describe(compose([*micro, "method=mardm_ddpm", "generator=mar_s"], "evaluate")).folder.path.name
    assert name.startswith("generation-mardm_ddpm-s-essential-synthetic-smoke-s0-")
    real = describe(compose([*micro, "source=real"], "evaluate")).folder.path.name
    assert real.startswith("real-synthetic-smoke-s0-")


def test_the_fingerprint_finds_a_run_whatever_it_is_called(tmp_path):
    """A scale of a user's own shares what it doesn't change, for instance the evaluators."""
    here = f"paths.runs={tmp_path}"
    made = folder("matching", here)
    made.mkdir(parents=True)
    assert folder("matching", here, "scale.name=mine") == made
    assert folder("matching", here, "scale.name=mine", "evaluator.matching.train.lr=1") != made
    assert run_identity(made) == run_identity(made.with_name(made.name.replace("smoke", "mine")))


def test_a_run_of_another_name_is_told_by_its_weights(tmp_path):
    """The last part of a name that someone gave is no fingerprint: two copies called best are two models."""
    names = []
    for parent, content in (("a", b"one"), ("b", b"two"), ("c", b"one")):
        run = tmp_path / parent / "ours-best"
        run.mkdir(parents=True)
        (run / "config.yaml").touch()
        (run / "weights.safetensors").write_bytes(content)
        names.append(run_identity(run))
    assert names[0] == names[2] != names[1]


def test_runs_lie_below_the_directory_of_the_command(monkeypatch, tmp_path):
    monkeypatch.delenv("KINEMA_RUNS", raising=False)
    monkeypatch.chdir(tmp_path)
    assert folder("length").absolute().parent == tmp_path / "runs" / "length"
    monkeypatch.setenv("KINEMA_RUNS", str(tmp_path / "elsewhere"))
    assert folder("length").parent == tmp_path / "elsewhere" / "length"

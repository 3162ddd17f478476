"""Every option of the machine, the loggers and the corpus goes through a micro stage."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from kinema.experiments.config import compose
from kinema.experiments.evaluation import describe, run_evaluation
from kinema.experiments.run import run_stage
from kinema.pipeline import TextToMotion
from kinema.runs.lines import read_lines
from kinema.runs.weights import load, read_meta
from kinema.training.fit import Machine

COMPILER = shutil.which("g++") or shutil.which("c++") or shutil.which("clang++")
ROOT = Path(__file__).resolve().parents[2]
BRIEF = [
    "tokenizer.train.steps=4",
    "generator.train.steps=4",
    "generator.train.validate_every=4",
    "tokenizer.train.validate_every=4",
    "evaluator.matching.train.steps=4",
    "evaluator.matching.train.validate_every=4",
]


@pytest.fixture
def brief(overrides) -> list[str]:
    return [*overrides, *BRIEF]


def weights(run) -> dict[str, torch.Tensor]:
    return load_file(run.weights)


def test_bf16_trains_a_generator_whose_weights_stay_float32(brief):
    run = run_stage(compose([*brief, "trainer.precision=bf16-mixed"]), "generator")
    assert {v.dtype for v in weights(run).values() if v.is_floating_point()} == {torch.float32}
    assert all(v.isfinite().all() for v in weights(run).values())
    assert run.status["val_loss"] < 10


@pytest.mark.slow
@pytest.mark.skipif(COMPILER is None, reason="torch.compile on a CPU needs a C++ compiler")
def test_compiling_changes_neither_the_run_nor_its_weights(brief, tmp_path):
    small = [*brief, "tokenizer.model.depth=1", "tokenizer.model.down_levels=1"]  # compiling takes its time
    plain = run_stage(compose([*small, f"paths.runs={tmp_path}/plain"]), "tokenizer")
    cfg = compose([*small, "trainer.compile=true"])
    # In a process of its own: the shape checks of the tests' imports can't be compiled.
    command = [sys.executable, str(ROOT / "train.py"), "stage=tokenizer", *small, "trainer.compile=true"]
    subprocess.run(command, check=True, capture_output=True, env={**os.environ, "OMP_NUM_THREADS": "1"})
    compiled = run_stage(cfg, "tokenizer")
    assert compiled.path.name == plain.path.name
    ours, theirs = weights(compiled), weights(plain)
    assert ours.keys() == theirs.keys()
    for name, value in theirs.items():
        torch.testing.assert_close(ours[name], value, rtol=1e-2, atol=1e-3, msg=name)


def test_workers_give_the_same_weights(brief, tmp_path):
    alone = run_stage(compose([*brief, f"paths.runs={tmp_path}/alone"]), "tokenizer")
    helped = run_stage(compose([*brief, "data.workers=2"]), "tokenizer")
    theirs = weights(alone)
    assert all(torch.equal(value, theirs[name]) for name, value in weights(helped).items())


@pytest.mark.parametrize(
    ("logger", "files"),
    [
        ("csv", ["logs/csv/metrics.csv"]),
        ("tensorboard", ["logs/csv/metrics.csv", "logs/tensorboard/events.out.tfevents.*"]),
        ("wandb", ["logs/csv/metrics.csv", "logs/wandb/offline-run-*/*.wandb"]),
        ("none", []),
    ],
)
def test_loggers_write_into_the_run_folder(brief, logger, files, monkeypatch):
    monkeypatch.setenv("WANDB_SILENT", "true")
    run = run_stage(compose([*brief, f"logger={logger}", "trainer.log_every=1"]), "tokenizer")
    for pattern in files:
        assert len(list(run.path.glob(pattern))) == 1, pattern
    assert (run.path / "logs").exists() == bool(files)
    assert [line["step"] for line in read_lines(run.path / "metrics.jsonl")] == [1, 2, 3, 4, 4]
    if logger == "wandb":
        import wandb

        assert wandb.run is None  # the next run must not log into this one


def test_samples_are_drawn_during_training(brief):
    run = run_stage(compose([*brief, "callbacks.samples_every=4", "callbacks.sample_prompts=2"]), "generator")
    (page,) = (run.path / "samples").iterdir()
    assert page.name == "step-0000004.html"
    assert "<canvas" in page.read_text()


def judged(cfg) -> dict[str, float]:
    row = run_evaluation(cfg)
    assert len(row.lines) == row.replications == 1
    return row.lines[0]["metrics"]


def test_kit_goes_all_the_way(brief):
    kit = [*brief, "data=synthetic_kit", "scale.protocol.replications=1"]
    metrics = judged(compose([*kit, "source=generation"], "evaluate"))
    assert 0 <= metrics["r1"] <= metrics["r3"] <= 1
    assert metrics["fid"] > 0
    row = describe(compose([*kit, "source=generation"], "evaluate"))
    for name, width in (("matching", 64), ("generator", None)):
        meta = read_meta(row.runs[name] / "weights.safetensors")
        assert width is None or load(row.runs[name] / "weights.safetensors")[0].representation.width == width
        assert meta["part"] == name
    redundant = run_stage(compose([*kit, "representation=redundant"]), "tokenizer")
    assert load(redundant.weights)[0].representation.width == 251


def test_redundant_motion_is_judged_on_essential_dims(brief):
    redundant = [*brief, "representation=redundant", "scale.protocol.replications=1"]
    cfg = compose([*redundant, "source=generation"], "evaluate")
    judged(cfg)
    row = describe(cfg)
    assert load(row.runs["matching"] / "weights.safetensors")[0].representation.width == 67
    tokenizer = run_stage(compose(redundant), "tokenizer")
    assert load(tokenizer.weights)[0].representation.width == 263
    assert row.folder.path.name.startswith("generation-mardm_sit-xl-redundant-synthetic-smoke-s0-")
    identity = row.lines[0]["provenance"]["statistics"]["evaluator"]
    assert identity["kind"] == "essential"


def test_products_in_bfloat16_are_a_row_of_their_own_that_is_scored_nearly_the_same(brief):
    asked = [*brief, "source=generation", "scale.protocol.replications=1"]
    whole, short = (compose([*asked, f"precision={name}"], "evaluate") for name in ("float32", "bfloat16"))
    assert describe(short).folder.path.name.startswith("generation_bfloat16-mardm_sit-")
    assert describe(whole).folder == describe(compose(asked, "evaluate")).folder
    one, other = judged(whole), judged(short)
    assert one["fid"] != other["fid"]
    assert one["fid"] == pytest.approx(other["fid"], rel=0.05)
    assert describe(short).lines[0]["provenance"]["precision"] == "bfloat16"


def test_the_redundant_judge_reads_real_motion(brief):
    redundant = [*brief, "evaluator=redundant", "scale.protocol.replications=1", "source=real"]
    metrics = judged(compose(redundant, "evaluate"))
    assert metrics["fid"] == pytest.approx(0, abs=1e-2)
    assert "clip_score" not in metrics  # no table reads it: its evaluator is neither trained nor asked
    row = describe(compose(redundant, "evaluate"))
    assert list(row.judges) == ["matching"]
    whole = describe(compose([*redundant, "evaluator.unread=[]"], "evaluate"))
    assert whole.folder == row.folder  # the same row: who wants all of its metrics has it scored again
    assert (row.missing, whole.missing) == ((), (0,))
    identity = row.lines[0]["provenance"]["statistics"]["evaluator"]
    assert (identity["kind"], identity["variant"]) == ("redundant", "published")


@pytest.mark.parametrize("accelerator", ["cpu", "auto"])
def test_a_cpu_does_not_compute_in_bf16_under_the_name_of_fp16(accelerator, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(torch.backends.mps, "is_available", lambda: False)
    with pytest.raises(ValueError, match=r"precision=16-mixed on a CPU computes in bf16.*bf16-mixed or 32-true"):
        Machine(accelerator=accelerator, precision="16-mixed").check()
    Machine(accelerator=accelerator, precision="bf16-mixed").check()


def test_what_changes_a_result_is_no_extra_of_the_machine():
    assert Machine(extra={"benchmark": True}).extra == {"benchmark": True}
    with pytest.raises(ValueError, match=r"trainer\.extra\.accumulate_grad_batches: only benchmark, .* leave"):
        Machine(extra={"accumulate_grad_batches": 4})


@pytest.mark.parametrize("machine", [["trainer.precision=16-mixed"], ["trainer.accelerator=gpu"], ["trainer=gpu"]])
def test_another_machine_is_planned_and_listed_here_and_refused_where_training_starts(overrides, machine, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(torch.backends.mps, "is_available", lambda: False)
    own = [*overrides, *machine, "trainer.precision=16-mixed"]
    assert describe(compose([*own, "source=real"], "evaluate")).missing  # a login node without a GPU asks this
    cfg = compose(own)
    with pytest.raises(ValueError, match=r"precision=16-mixed on a CPU|cannot be used here") as told:
        run_stage(cfg, "generator")
    assert "\n" not in str(told.value)
    assert not list(Path(cfg.paths.runs).rglob("config.yaml"))


def test_debug_runs_are_short_and_kept_apart(overrides, tmp_path):
    run = run_stage(compose([*overrides, "debug=steps", "debug.steps=3"]), "generator")
    assert run.status["step"] == 3
    assert run.path.is_relative_to(tmp_path / "runs-debug")
    assert not (tmp_path / "runs").exists()
    links = json.loads((Path(run.path) / "upstream.json").read_text())
    assert all((run.path / link / "weights.safetensors").exists() for link in links.values())


def test_two_judges_are_shown_the_same_motion_and_it_is_generated_once(brief, tmp_path, monkeypatch):
    asked = [*brief, "source=generation", "scale.protocol.replications=1", "keep_motions=true"]
    one = compose([*asked, f"paths.cache={tmp_path}/cache"], "evaluate")
    first = judged(one)
    again = compose([*asked, f"paths.cache={tmp_path}/cache", "evaluator=redundant", "lift=true"], "evaluate")
    alone = judged(compose([*asked, "keep_motions=false", "evaluator=redundant", "lift=true"], "evaluate"))
    shutil.rmtree(describe(again).folder.path)  # the same row
    with monkeypatch.context() as patch:
        patch.setattr(TextToMotion, "sample", None)  # any work would fail
        second = judged(again)
    assert second == alone
    calls = {name: value for name, value in first.items() if name.endswith(("_calls", "_rows"))}
    assert calls
    assert calls.items() <= second.items()

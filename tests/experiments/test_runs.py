"""Runs are found, resumed, shared and recorded: nothing is trained twice, nothing is half-written."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from kinema.experiments import training
from kinema.experiments.config import compose
from kinema.experiments.run import run_folder, run_stage
from kinema.experiments.stages.base import Summary
from kinema.runs.console import console
from kinema.runs.folder import RunFolder
from kinema.runs.lines import append_line, read_lines
from kinema.runs.parts import upstream

pytestmark = pytest.mark.usefixtures("unchecked")

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def fake_training(monkeypatch):
    """Replace training by a file of weights; gives the list of what was trained."""
    trained = []

    def train(stage, cfg, store, needs, folder):
        trained.append(stage.name)
        folder.weights.write_bytes(b"weights")
        return Summary(1.0)

    monkeypatch.setattr(training, "make_model", train)
    return trained


def test_a_finished_run_is_given_back_untouched(micro, monkeypatch):
    cfg = compose([*micro, "stage=generator"])
    first = run_stage(cfg, "generator")
    files = {p: p.stat().st_mtime_ns for p in first.path.rglob("*") if p.is_file()}
    monkeypatch.setattr(training, "make_model", lambda *_: pytest.fail("trained again"))
    with console.capture() as said:
        again = run_stage(compose([*micro, "trainer.log_every=7", "data.workers=3"]), "generator")
    assert again.path == first.path
    assert said.get() == f"cached    {first.path}\ndashboard {first.path / 'logs' / 'csv'}\n"
    assert files == {p: p.stat().st_mtime_ns for p in first.path.rglob("*") if p.is_file()}


def test_a_run_holds_its_record(micro):
    run = run_stage(compose(micro), "generator")
    status = run.status
    assert status["state"] == "done"
    assert status["step"] == 24
    assert status["device"] == "cpu"
    assert status["parameters"] > 0
    assert {"python", "torch", "lightning", "kinema"} <= status["versions"].keys()
    assert "scale" in (run.path / "config.yaml").read_text()
    assert "hydra" not in (run.path / "config.yaml").read_text().split()
    tokenizer = upstream(run.path)["tokenizer"]
    assert RunFolder(tokenizer).done
    assert [line["step"] for line in read_lines(run.path / "metrics.jsonl") if "val/loss" in line] == [8, 16, 24]
    assert not list((run.path / "checkpoints").iterdir())


def test_what_is_missing_is_named_with_its_command(overrides, fake_training):
    cfg = compose([*overrides, "ensure=false"])
    with pytest.raises(FileNotFoundError, match=r"`kinema train stage=tokenizer .*data=synthetic.*` or set ensure"):
        run_stage(cfg, "generator")
    assert not fake_training
    for stage in ("tokenizer", "length", "generator"):
        run_stage(cfg, stage)
    assert fake_training == ["tokenizer", "length", "generator"]


def test_upstream_is_trained_where_it_is_missing_and_once(overrides, fake_training):
    run_stage(compose(overrides), "generator")
    run_stage(compose([*overrides, "seed=0", "method=mardm_ddpm"]), "generator")
    assert fake_training == ["tokenizer", "length", "generator", "generator"]


def test_one_of_two_who_want_the_same_run_trains_it(overrides, monkeypatch):
    trained, waiting, said = [], threading.Event(), []

    def train(stage, cfg, store, needs, folder):
        trained.append(threading.current_thread().name)
        assert waiting.wait(60)
        folder.weights.write_bytes(b"weights")
        return Summary(1.0)

    def listen(text, *_, **__):
        said.append(text)
        if text.startswith("waiting"):
            waiting.set()

    monkeypatch.setattr(training, "make_model", train)
    monkeypatch.setattr(console, "print", listen)
    cfg = compose(overrides)
    threads = [threading.Thread(target=run_stage, args=(cfg, "tokenizer")) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert len(trained) == 1
    assert [text.split()[0] for text in said] in (
        ["train", "waiting", "done", "cached"],
        ["waiting", "train", "done", "cached"],
    )


@pytest.mark.slow
def test_two_processes_share_one_run(overrides):
    command = [sys.executable, "train.py", *overrides, "stage=tokenizer"]
    env = {**os.environ, "OMP_NUM_THREADS": "1"}
    two = [subprocess.Popen(command, cwd=ROOT, env=env, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    outputs = [process.communicate(timeout=300)[0] for process in two]
    assert [process.returncode for process in two] == [0, 0]
    assert sum("train     " in output for output in outputs) == 1
    assert sum("cached    " in output for output in outputs) == 1


def test_a_failed_run_says_why_and_can_be_run_again(overrides, fake_training, monkeypatch):
    cfg, train = compose(overrides), training.make_model

    def fail(*_):
        raise RuntimeError("out of luck")

    monkeypatch.setattr(training, "make_model", fail)
    with pytest.raises(RuntimeError, match="out of luck"):
        run_stage(cfg, "tokenizer")
    (folder,) = [RunFolder(p) for p in Path(cfg.paths.runs, "tokenizer").iterdir()]
    assert folder.status["state"] == "failed"
    assert folder.status["error"] == "RuntimeError: out of luck"
    assert not folder.done
    monkeypatch.setattr(training, "make_model", train)
    assert run_stage(cfg, "tokenizer").done
    assert "error" not in folder.status


def test_status_is_replaced_whole_or_not_at_all(tmp_path, monkeypatch):
    folder = RunFolder(tmp_path)
    assert folder.status == {"state": "pending"}
    folder.mark("running", versions={"torch": "2"})

    def full(self, *_, **__):
        self.touch()
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_text", full)
        with pytest.raises(OSError, match="No space left"):
            folder.mark("done")
    assert folder.status == {"state": "running", "versions": {"torch": "2"}}
    assert [p.name for p in tmp_path.iterdir()] == ["status.json"]
    folder.mark("done", seconds=1)
    assert folder.status == {"state": "done", "versions": {"torch": "2"}, "seconds": 1}
    assert not folder.done  # its weights are missing


def test_a_damaged_status_is_named(tmp_path):
    (tmp_path / "status.json").write_text('{"state": "do')
    with pytest.raises(ValueError, match=r"status\.json is damaged .*delete this run folder"):
        _ = RunFolder(tmp_path).status


def test_a_torn_line_is_named_and_swallows_no_other(tmp_path):
    path = tmp_path / "replications.jsonl"
    append_line(path, {"replication": 0})
    with open(path, "a") as file:
        file.write('{"replication": 1, "met')  # the process died here
    append_line(path, {"replication": 2})
    with console.capture() as said:
        assert read_lines(path) == [{"replication": 0}, {"replication": 2}]
    assert f"{path}:2 is not a whole line" in said.get()
    assert read_lines(tmp_path / "none.jsonl") == []


@pytest.mark.parametrize("name", ["../../x", "/etc", "a/b", "a\nb", "a\x1b[2J", "..", "$(ls)", "a\\b", "a b", "[bold]"])
def test_a_name_makes_no_folder_of_its_own(micro, name):
    cfg = compose(micro)
    cfg.data.name = name
    folder = run_folder(cfg, "tokenizer", "ae-essential", None, 0, "0123456789ab").path
    assert folder.parent == Path(cfg.paths.runs) / "tokenizer"
    assert re.fullmatch(r"ae-essential-[\w.]+-smoke-s0-0123456789ab", folder.name)

"""Interrupt by SIGTERM and Ctrl-C what trains: no success, one line, nothing after it starts, and all of it goes on."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from kinema.experiments import multirun
from kinema.experiments.config import compose
from kinema.experiments.jobs import EVALUATE, Job
from kinema.experiments.run import run_stage
from kinema.runs.console import console
from kinema.runs.folder import RunFolder
from kinema.signals import Interrupted, ended_by_signal
from kinema.training.callbacks import Checkpoints, RunRecord
from kinema.training.fit import BARS

ROOT = Path(__file__).resolve().parents[2]
ENDLESS = ["tokenizer.train.steps=30000", "tokenizer.train.validate_every=30000"]
TABLE = """
import sys
from collections.abc import Iterator
from pathlib import Path
from kinema.experiments import reproduce
from kinema.experiments.table_files import load_table
whole = load_table("table5")
rows = [{**row, "overrides": []} for row in whole["rows"] if row.get("source") == "reconstruction"]
reproduce.load_table = lambda name: {**whole, "rows": rows}
if __name__ == "__main__":
    reproduce.main(["table5", "--jobs", "2", "--out", "report", *sys.argv[1:]])
"""


def start(*command: str, log: Path, cwd: Path = ROOT) -> subprocess.Popen:
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"}
    with log.open("w") as file:
        return subprocess.Popen(
            [sys.executable, *command],
            cwd=cwd,
            stdout=file,
            stderr=subprocess.STDOUT,
            env=environment,
            start_new_session=True,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # shells ignore it in the background
        )


def interrupt(process: subprocess.Popen, runs: Path, signum: int) -> int:
    """Send the signal once a tokenizer has saved a checkpoint, and give the exit code."""
    while process.poll() is None and not list(runs.glob("tokenizer/*/checkpoints/last.ckpt")):
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(0.05)
    if signum == signal.SIGINT:
        os.killpg(process.pid, signum)  # as a terminal does
    else:
        process.send_signal(signum)
    return process.wait(120)


@pytest.fixture
def hears_sigint() -> Iterator[None]:
    """Take SIGINT as Python does: shells ignore it in the background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("hears_sigint")
@pytest.mark.parametrize("signum", [signal.SIGTERM, signal.SIGINT])
def test_training_says_where_it_was_interrupted_and_goes_on(signum, overrides, monkeypatch):
    """At step 12 of 24, the checkpoint being of step 10: what the resumed run then has is test_resume.py's to say."""
    ended = Checkpoints.on_train_batch_end

    def interrupted(self, trainer, *rest):
        ended(self, trainer, *rest)
        if trainer.global_step == 12:
            os.kill(os.getpid(), signum)

    monkeypatch.setattr(Checkpoints, "on_train_batch_end", interrupted)
    name = signal.Signals(signum).name
    line = f"interrupted at step 12 of 24 ({name}); run the same command again to go on from step 10"
    with console.capture() as said, pytest.raises(Interrupted) as stop:
        run_stage(compose(overrides), "tokenizer")
    assert stop.value.code == 128 + signum
    (folder,) = (RunFolder(path) for path in Path(compose(overrides).paths.runs).glob("tokenizer/*"))
    assert said.get().splitlines()[-1] == f"stopped   {folder.path}: {line}"
    assert (folder.status["state"], folder.status["error"]) == ("interrupted", line)
    monkeypatch.undo()
    assert run_stage(compose(overrides), "tokenizer").path == folder.path
    assert folder.done
    assert "error" not in folder.status


@pytest.mark.parametrize("bar", ["rich", "tqdm"])
def test_a_resumed_bar_counts_the_steps_of_the_whole_run(bar, overrides, monkeypatch):
    seen = []

    class Watched(BARS[bar]):
        def on_train_batch_end(self, *arguments):
            super().on_train_batch_end(*arguments)
            line = self.progress.tasks[0] if bar == "rich" else self.train_progress_bar
            seen.append((line.completed, line.total) if bar == "rich" else (line.n, line.total))

    monkeypatch.setitem(BARS, bar, Watched)
    own = compose([*overrides, f"trainer.progress={bar}"])
    ended = RunRecord.on_train_batch_end

    def interrupted(self, trainer, *rest):
        ended(self, trainer, *rest)
        if trainer.global_step == 22:
            os.kill(os.getpid(), signal.SIGTERM)

    with monkeypatch.context() as once:
        once.setattr(RunRecord, "on_train_batch_end", interrupted)
        with pytest.raises(Interrupted):
            run_stage(own, "tokenizer")
    assert seen[-1] == (21, 24)
    seen.clear()
    run_stage(own, "tokenizer")
    assert seen == [(step, 24) for step in range(21, 25)]


@pytest.mark.slow
def test_what_the_scores_select_outlives_an_interruption(overrides, tmp_path, monkeypatch):
    """Scored at steps 3, 6, 9 and 12; the interrupted run goes on from step 10, with what was best until then."""
    brief = [*overrides, "generator.train.select=fid", "callbacks.score_every=3", "callbacks.score_clips=16"]
    brief += ["generator.train.steps=12", "logger=none"]
    straight = run_stage(compose(brief), "generator")
    other = tmp_path / "other"
    other.mkdir()
    for stage in (tmp_path / "runs").iterdir():
        if stage.name != "generator":
            (other / stage.name).symlink_to(stage)
    own = compose([*brief, f"paths.runs={other}"])
    ended = Checkpoints.on_train_batch_end

    def interrupted(self, trainer, *rest):
        ended(self, trainer, *rest)
        if trainer.global_step == 11:
            os.kill(os.getpid(), signal.SIGTERM)

    with monkeypatch.context() as once:
        once.setattr(Checkpoints, "on_train_batch_end", interrupted)
        with pytest.raises(Interrupted, match="from step 10"):
            run_stage(own, "generator")
    resumed = run_stage(own, "generator")
    assert resumed.status["step"] == straight.status["step"]
    ours, theirs = load_file(resumed.weights), load_file(straight.weights)
    assert all(torch.equal(ours[name], value) for name, value in theirs.items())


@pytest.mark.slow
def test_an_interrupted_job_of_a_sweep_is_the_last(overrides, tmp_path):
    own = [*overrides, *ENDLESS, f"hydra.sweep.dir={tmp_path}/sweep", "stage=tokenizer", "seed=0,1", "-m"]
    code = interrupt(start("train.py", *own, log=tmp_path / "log"), tmp_path / "runs", signal.SIGTERM)
    said = (tmp_path / "log").read_text()
    assert code == 143, said
    assert len([line for line in said.splitlines() if line.startswith("stopped")]) == 1
    assert "Traceback" not in said
    assert len(list((tmp_path / "runs/tokenizer").iterdir())) == 1  # the second was not begun


@pytest.mark.slow
@pytest.mark.parametrize("signum", [signal.SIGTERM, signal.SIGINT])
def test_a_table_that_is_interrupted_ends_its_processes_and_renders_nothing(signum, overrides, tmp_path):
    """One of its two processes trains, the other has nothing to do."""
    (tmp_path / "table.py").write_text(TABLE)
    log = tmp_path / "log"
    process = start("table.py", *overrides, *ENDLESS, log=log, cwd=tmp_path)
    assert interrupt(process, tmp_path / "runs", signum) == 128 + signum, log.read_text()
    said = log.read_text()
    assert re.search(r"^stopped .*interrupted at step \d+ of 30000", said, re.MULTILINE), said
    assert "what is finished is kept" in said
    assert "Traceback" not in said
    assert not (tmp_path / "report").exists()
    states = [json.loads(file.read_text())["state"] for file in (tmp_path / "runs").glob("*/*/status.json")]
    assert "interrupted" in states
    assert "running" not in states  # no process was left behind to go on


@pytest.mark.parametrize(
    ("code", "signum"),
    [(143, signal.SIGTERM), (130, signal.SIGINT), (-15, signal.SIGTERM), (-2, signal.SIGINT), (0, None), (1, None),
     (2, None), (-9, None), (137, None)],
)  # fmt: skip
def test_exit_codes_tell_an_interruption_from_a_failure(code, signum):
    assert ended_by_signal(code) == signum


def test_an_interrupted_multirun_is_the_last(monkeypatch, tmp_path):
    begun = []

    class Call:
        def __init__(self, words, env):
            begun.append(words)

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def wait(self):
            return 143

    monkeypatch.setattr(multirun.subprocess, "Popen", Call)
    jobs = [Job(EVALUATE, (f"source={name}", *own), tmp_path / name) for name, *own in (("real",), ("noise", "a=1"))]
    with pytest.raises(Interrupted) as stop:
        multirun.run_multiruns(jobs, [])
    assert stop.value.code == 143
    assert len(begun) == 1


def test_an_interruption_keeps_what_it_says_between_processes():
    import pickle

    stop = Interrupted(signal.SIGTERM, " at step 3 of 9", " from step 2")
    again = pickle.loads(pickle.dumps(stop))
    assert (
        str(again)
        == str(stop)
        == "interrupted at step 3 of 9 (SIGTERM); run the same command again to go on from step 2"
    )
    assert again.code == 143

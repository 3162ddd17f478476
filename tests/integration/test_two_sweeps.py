"""Two multiruns at once on the same rows, one of them killed and started again: nothing is trained twice or lost."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from kinema.experiments.config import compose
from kinema.experiments.evaluation import run_evaluation
from kinema.experiments.replications import scored_lines

ROOT = Path(__file__).parents[2]
SOURCES = ("real", "shuffled", "reconstruction")


def start(overrides: list[str], log: Path) -> subprocess.Popen:
    command = [
        sys.executable,
        "evaluate.py",
        *overrides,
        f"source={','.join(SOURCES)}",
        f"hydra.sweep.dir={log}.sweep",
        "-m",
    ]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"}
    with log.open("w") as file:
        return subprocess.Popen(
            command, cwd=ROOT, stdout=file, stderr=subprocess.STDOUT, env=environment, start_new_session=True
        )


@pytest.mark.slow
def test_two_multiruns_one_killed_make_what_one_makes_alone(overrides, tmp_path):
    first, second = start(overrides, tmp_path / "first"), start(overrides, tmp_path / "second")
    while not list((tmp_path / "runs").glob("*/*/weights.safetensors")):
        assert first.poll() is None, (tmp_path / "first").read_text()
        time.sleep(0.02)
    os.killpg(first.pid, signal.SIGKILL)
    first.wait()
    again = start(overrides, tmp_path / "again")
    assert (second.wait(300), again.wait(300)) == (0, 0), (tmp_path / "again").read_text()
    said = "".join((tmp_path / name).read_text() for name in ("first", "second", "again"))
    finished = re.findall(r"^done +(\S+) in", said, re.MULTILINE)
    assert len(finished) == len(set(finished)), finished
    trained = {str(path.parent) for path in (tmp_path / "runs").glob("*/*/weights.safetensors")}
    assert set(finished) <= trained
    for source in SOURCES:
        cfg = compose([*overrides, f"source={source}"], "evaluate")
        place = run_evaluation(cfg)
        lines = scored_lines(place.folder.path)
        assert sorted(line["replication"] for line in lines) == [0, 1]
        alone = run_evaluation(compose([*overrides, f"source={source}", f"paths.runs={tmp_path}/alone"], "evaluate"))
        assert [line["metrics"] for line in place.lines] == [line["metrics"] for line in alone.lines]

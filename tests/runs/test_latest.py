"""`latest:NAME` is the last finished run of that name."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from kinema.runs.folder import RunFolder
from kinema.runs.latest import find_run


@pytest.fixture
def runs(tmp_path) -> Path:
    """Write run folders that ended in this order."""
    names = [
        ("generator/mardm_sit-essential-synthetic-tiny-s0-0a", "done"),
        ("generator/mardm_sit-essential-synthetic-smoke-s1-0b", "done"),
        ("generator/mardm_sit-essential-synthetic-smoke-s0-0c", "failed"),
        ("generator/mardm_ddpm-essential-synthetic-tiny-s0-0d", "done"),
        ("residual/mardm_sit-essential-synthetic-tiny-s0-0e", "done"),
    ]
    for second, (name, state) in enumerate(names):
        run = RunFolder(tmp_path / "runs" / name)
        run.mark(state)
        run.weights.touch()
        os.utime(run.path / "status.json", (second, second))
    return tmp_path / "runs"


@pytest.mark.parametrize(
    ("asked", "found"),
    [
        ("latest:generator/mardm_sit", "0b"),
        ("latest:mardm_sit", "0e"),
        ("latest:generator/mardm_sit-tiny", "0a"),
        ("latest:mardm_sit-s1-smoke", "0b"),
        ("latest:mardm_ddpm", "0d"),
    ],
)
def test_it_is_the_last_that_finished(runs, asked, found):
    assert find_run(asked, runs).name.endswith(found)


@pytest.mark.parametrize("content", ["{", "{}", "[]", '{"state": 5}'])
def test_what_is_damaged_is_left_out_with_a_word(runs, content, capsys):
    damaged = runs / "generator" / "mardm_sit-essential-synthetic-tiny-s0-0f" / "status.json"
    damaged.parent.mkdir()
    damaged.write_text(content)
    assert find_run("latest:generator/mardm_sit", runs).name.endswith("0b")
    told = capsys.readouterr().out
    assert "status.json" in told
    assert told.strip().endswith("left out")


def test_a_path_stays_a_path(runs):
    assert find_run("somewhere/else") == Path("somewhere/else")
    assert find_run(runs / "generator") == runs / "generator"


def test_runs_are_looked_for_where_they_are_written(runs, monkeypatch, tmp_path):
    monkeypatch.delenv("KINEMA_RUNS", raising=False)
    monkeypatch.chdir(runs.parent)
    assert find_run("latest:mardm_ddpm").is_dir()
    monkeypatch.chdir("/")
    monkeypatch.setenv("KINEMA_RUNS", str(runs))
    assert find_run("latest:mardm_ddpm").is_dir()


@pytest.mark.parametrize("asked", ["latest:mardm", "latest:mardm_sit-huge", "latest:length/mardm_sit"])
def test_what_there_is_is_named(runs, asked):
    with pytest.raises(FileNotFoundError, match=r"no finished run .*generator/mardm_ddpm-essential-synthetic-tiny-s0"):
        find_run(asked, runs)
    with pytest.raises(FileNotFoundError, match="no run has finished there"):
        find_run(asked, runs / "generator")

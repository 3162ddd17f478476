"""What `kinema runs`, `compare` and `info` say of runs in any state, finished or not, and of folders that are none."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from kinema import cli
from kinema.locks import hold
from kinema.runs.folder import RunFolder
from kinema.runs.lines import append_line


@pytest.fixture
def runs(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("KINEMA_RUNS", raising=False)
    return tmp_path / "runs"


def make(root: Path, name: str, state: str = "done", *, last: int = 20, width: int = 8, **status) -> RunFolder:
    """Make a run folder as training leaves it, without weights."""
    folder = RunFolder(root / name)
    folder.path.mkdir(parents=True)
    model = {"_target_": "kinema.generators.mar.MARDM", "width": width}
    config = {"data": {"name": "own", "options": {}}, "scale": {"name": "tiny", "protocol": {"replications": 3}}}
    config |= {"generator": {"model": model, "train": {"steps": 24}}, "tokenizer": {"train": {"steps": 9}}}
    config |= {"paths": {"runs": str(root)}, "source": "generation"}
    (folder.path / "config.yaml").write_text(yaml.safe_dump(config))
    append_line(folder.path / "metrics.jsonl", {"step": last, "train/loss": 1.0})
    folder.mark(state, **status)
    return folder


def score(root: Path, run: str, *fids: float) -> RunFolder:
    folder = make(root, "evaluation/generation-mardm_sit-tiny-s0-0123456789ab", "done" if len(fids) == 3 else "failed")
    for i, fid in enumerate(fids):
        provenance = {"runs": {"generator": run}, "corpus": {"name": "own"}}
        line = {"replication": i, "metrics": {"fid": fid}, "breakdowns": {}, "provenance": provenance, "seconds": 1.0}
        append_line(folder.path / "replications.jsonl", line)
    return folder


def said(capsys, *words: str) -> str:
    capsys.readouterr()
    assert cli.main([*words]) == 0
    return capsys.readouterr().out


def refused(capsys, *words: str) -> str:
    capsys.readouterr()
    assert cli.main([*words]) == 2
    told = capsys.readouterr().err
    assert told.startswith("error: ")
    assert told.count("\n") == 1
    return told


def test_a_list_says_how_far_runs_are_and_what_tells_them_apart(runs, capsys):
    make(runs, "generator/mardm_sit-own-tiny-s0-000000000001", "done", step=24, val_loss=0.25)
    make(runs, "generator/mardm_sit-own-tiny-s0-000000000002", "failed", width=16)
    make(runs, "tokenizer/ae-own-tiny-s0-000000000003", "interrupted")
    make(runs, "generator/mmm-own-tiny-s0-000000000004", "running")
    busy = make(runs, "generator/bad-own-tiny-s0-000000000005", "running")
    score(runs, "mardm_sit-own-tiny-s0-000000000001", 1.0, 2.0, 3.0)
    with hold(busy.path / ".lock"):
        table = [" ".join(line.split()) for line in said(capsys, "runs").splitlines()]
    assert table[0] == "state step run corpus scale scores differs in"
    assert table[1:] == [
        "interrupted 20/9 tokenizer/ae-own-tiny-s0-000000000003 own tiny",
        "running 20/24 generator/bad-own-tiny-s0-000000000005 own tiny",
        "done 24/24 generator/mardm_sit-own-tiny-s0-000000000001 own tiny fid 2.000 ± 2.484 model.width=8",
        "failed 20/24 generator/mardm_sit-own-tiny-s0-000000000002 own tiny model.width=16",
        "killed 20/24 generator/mmm-own-tiny-s0-000000000004 own tiny",
        "done 3/3 evaluation/generation-mardm_sit-tiny-s0-0123456789ab own tiny fid 2.000 ± 2.484",
    ]
    assert len(said(capsys, "runs", "generator", "failed").splitlines()) == 2


def test_nothing_is_silently_empty(runs, capsys):
    assert f"there is no folder of runs at {runs}; " in refused(capsys, "runs")
    make(runs, "generator/mmm-own-tiny-s0-000000000004")
    assert "holds no runs whose stage, name or state hold momask" in refused(capsys, "runs", "momask")
    assert "no folder of runs at" in refused(capsys, "runs", "--root", "elsewhere")


def test_two_runs_are_compared(runs, capsys):
    one = make(runs, "generator/mardm_sit-own-tiny-s0-000000000001", "done", step=24, val_loss=0.25, seconds=3.0)
    two = make(runs, "generator/mardm_sit-own-tiny-s1-000000000002", "interrupted", width=16)
    told = [" ".join(line.split()) for line in said(capsys, "compare", str(one.path), str(two.path)).splitlines()]
    assert told == [
        f"A = {one.path}",
        f"B = {two.path}",
        "A B",
        "generator.model.width 8 16",
        "state done interrupted",
        "step 24/24 20/24",
        "seconds 3.0",
        "val_loss 0.250",
    ]
    assert "is no run folder" in refused(capsys, "compare", str(one.path), str(runs))


@pytest.mark.parametrize("state", ["running", "failed", "interrupted", "pending"])
def test_info_describes_a_run_without_weights(state, runs, capsys):
    run = make(runs, "generator/mmm-own-tiny-s0-000000000004", state, error="the reason")
    told = json.loads(said(capsys, "info", str(run.path)))
    assert told["state"] == {"running": "killed"}.get(state, state)
    assert told["progress"] == "20/24"
    assert told["status"]["error"] == "the reason"


def test_info_describes_an_evaluation_that_lacks_replications(runs, capsys):
    told = json.loads(said(capsys, "info", str(score(runs, "a-run", 1.0, 2.0).path)))
    assert (told["state"], told["progress"]) == ("failed", "2/3")
    assert told["scores"]["fid"] == {"mean": 1.5, "interval": pytest.approx(6.353, abs=1e-3)}
    assert told["provenance"]["runs"] == {"generator": "a-run"}


def test_info_of_what_is_no_run_is_one_line(runs, capsys):
    runs.mkdir()
    assert "no weights at" in refused(capsys, "info", str(runs))
    assert "no weights at" in refused(capsys, "info", str(runs / "nothing"))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("a: &a [1, 1]\nb: [*a, *a]\n", "has an alias"),
        ("- 1\n", "is no mapping"),
        ("a: [1\n", "is no YAML"),
        ("\x00", "is no YAML"),
        ("a: !!python/object:os.system {}\n", "has the tag"),
    ],
)
def test_a_damaged_config_is_named(text, told, runs, capsys):
    run = make(runs, "generator/mmm-own-tiny-s0-000000000004")
    (run.path / "config.yaml").write_text(text)
    assert told in refused(capsys, "compare", str(run.path), str(run.path))


DAMAGE = [
    ("config.yaml", "a: &a [1, 1]\nb: [*a, *a]\n", "has an alias"),
    ("config.yaml", "a: [", "is no YAML"),
    ("config.yaml", "", "is empty"),
    ("metrics.jsonl", '{"train/loss": 1.0}\n', "has 'step': it holds null"),
    ("metrics.jsonl", '{"step": "three"}\n', "has 'step': it holds a text"),
    ("metrics.jsonl", "5\n", "holds a number"),
    ("metrics.jsonl", "[]\n", "holds a list"),
    ("status.json", "{", "is damaged"),
    ("status.json", "{}", "has 'state': it holds null"),
    ("status.json", '{"state": "done", "step": "x"}', "has 'step': it holds a text"),
]


@pytest.mark.parametrize(("file", "content", "told"), DAMAGE)
def test_a_damaged_run_has_a_line_and_the_list_goes_on(file, content, told, runs, capsys):
    bad = make(runs, "generator/mmm-own-tiny-s0-000000000004", "pending")
    make(runs, "generator/mmm-own-tiny-s1-000000000005", "done", step=24)
    (bad.path / file).write_text(content)
    table = said(capsys, "runs").splitlines()
    assert [line.split()[0] for line in table[1:]] == ["damaged", "done"]
    assert told in table[1]
    assert len(said(capsys, "runs", "damaged").splitlines()) == 2
    for command in (["info", str(bad.path)], ["compare", str(bad.path), str(bad.path)]):
        assert told in refused(capsys, *command)


@pytest.mark.parametrize("value", [5, "own", None, [], {"name": 5}, {"name": {"a": 1}}])
def test_a_configuration_of_odd_values_is_listed(value, runs, capsys):
    run = make(runs, "generator/mmm-own-tiny-s0-000000000004")
    (run.path / "config.yaml").write_text(json.dumps({"data": value, "scale": value, "generator": value}))
    assert said(capsys, "runs").splitlines()[1].startswith("done")
    said(capsys, "info", str(run.path))
    said(capsys, "compare", str(run.path), str(run.path))


@pytest.mark.parametrize("provenance", [{}, {"runs": 5}, {"runs": {}}, {"runs": {"generator": 5}}])
def test_an_evaluation_that_names_no_generator_is_nobodys(provenance, runs, capsys):
    make(runs, "generator/mmm-own-tiny-s0-000000000004")
    folder = score(runs, "mmm-own-tiny-s0-000000000004")
    line = {"replication": 0, "metrics": {"fid": 1.0}, "breakdowns": {}, "provenance": provenance, "seconds": 1.0}
    append_line(folder.path / "replications.jsonl", line)
    assert "fid" not in said(capsys, "runs", "mmm").splitlines()[1]


@pytest.mark.parametrize(
    "other",
    [{"lengths": "predicted"}, {"protocol": {"split": "val"}}, {"statistics": {"evaluator": {"kind": "redundant"}}}],
)
def test_a_generator_has_the_scores_of_the_tables_rows_alone(other, runs, capsys):
    run = "mmm-own-tiny-s0-000000000004"
    make(runs, f"generator/{run}")
    usual = {"runs": {"generator": run}, "lengths": "real", "protocol": {"split": "test"}}
    usual |= {"statistics": {"evaluator": {"kind": "essential"}}}
    for digest, fid, provenance in (("0123456789aa", 1.0, usual), ("0123456789ab", 7.0, usual | other)):
        folder = make(runs, f"evaluation/generation-mmm-tiny-s0-{digest}")
        line = {"replication": 0, "metrics": {"fid": fid}, "breakdowns": {}, "provenance": provenance, "seconds": 1.0}
        append_line(folder.path / "replications.jsonl", line)
    assert "fid 1.000" in next(line for line in said(capsys, "runs").splitlines() if f"generator/{run}" in line)


def test_a_method_that_ends_motion_itself_is_scored_by_its_own_lengths(runs, capsys):
    run = "t2m_gpt-own-tiny-s0-000000000004"
    make(runs, f"generator/{run}")
    for digest, fid, lengths in (("0123456789aa", 1.0, "predicted"), ("0123456789ab", 7.0, "real")):
        folder = make(runs, f"evaluation/generation-t2m_gpt-tiny-s0-{digest}")
        config = yaml.safe_load((folder.path / "config.yaml").read_text()) | {"method": {"lengths": "predicted"}}
        (folder.path / "config.yaml").write_text(yaml.safe_dump(config))
        provenance = {"runs": {"generator": run}, "lengths": lengths}
        line = {"replication": 0, "metrics": {"fid": fid}, "breakdowns": {}, "provenance": provenance, "seconds": 1.0}
        append_line(folder.path / "replications.jsonl", line)
    assert "fid 1.000" in next(line for line in said(capsys, "runs").splitlines() if f"generator/{run}" in line)


def test_who_has_read_enough_is_no_error(tmp_path):
    reader = subprocess.run(
        f"'{sys.executable}' -m kinema.cli info | head -c 1; exit ${{PIPESTATUS[0]}}",
        shell=True, executable="/bin/bash", capture_output=True, text=True,
    )  # fmt: skip
    assert reader.stdout == "{"
    assert reader.returncode in (0, 141)  # all may be in the pipe before the reader ends
    assert reader.stderr == ""


def test_completion_knows_commands_options_and_choices(tmp_path, capsys):
    script = tmp_path / "kinema.sh"
    script.write_text(said(capsys, "completion", "bash"))

    def completed(*words: str) -> list[str]:
        line = f"source {script}; COMP_WORDS=(kinema {' '.join(words)}); COMP_CWORD={len(words)}; _kinema"
        shown = subprocess.run(["bash", "-c", f"{line}; echo ${{COMPREPLY[@]}}"], capture_output=True, text=True)
        assert shown.stderr == ""
        return shown.stdout.split()

    assert completed("comp") == ["compare", "completion"]
    assert completed("prepare", "x", "--format", "h") == ["humanml3d"]
    assert "--regenerate" in completed("edit", "--r")
    assert "table5" in completed("reproduce", "table5")
    assert said(capsys, "completion", "zsh").endswith(script.read_text())

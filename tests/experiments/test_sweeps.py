"""A table's jobs as sweeps: joined into few multiruns, replications apart, seeds beside seeds, trials with results."""

from __future__ import annotations

import contextlib
import json
import os
import re
import stat
import sys
from pathlib import Path

import pytest

from kinema.experiments import entry, launching, reproduce
from kinema.experiments import run as running
from kinema.experiments.config import CONF, compose
from kinema.experiments.evaluation import describe, run_evaluation, tell_means
from kinema.experiments.jobs import EVALUATE, Job, JobsFailedError, missing_jobs, run_jobs
from kinema.experiments.multirun import sweeps
from kinema.experiments.plan import estimate
from kinema.experiments.replications import scored_lines
from kinema.experiments.request import Request
from kinema.experiments.table_files import load_table
from kinema.experiments.tables import plan, render_table
from kinema.runs.console import console
from kinema.runs.folder import RunFolder
from kinema.runs.lines import append_line

pytestmark = pytest.mark.usefixtures("unchecked")

STUDIES = sorted(file.stem for file in (CONF / "study").glob("*.yaml"))


def job(*overrides: str) -> Job:
    return Job(EVALUATE, overrides, Path("-".join(overrides)))


def small(*keys: str) -> dict:
    table = load_table("table5")
    return {**table, "rows": [row for row in table["rows"] if row["key"] in keys]}


@pytest.mark.parametrize("name", STUDIES)
def test_a_study_is_a_sweep_of_options_that_there_are(name):
    pytest.importorskip("hydra_plugins.hydra_optuna_sweeper", reason="needs the extra tune")
    from hydra import compose as hydra_compose
    from hydra import initialize_config_dir

    with initialize_config_dir(str(CONF), version_base="1.3"):
        whole = hydra_compose("evaluate", [f"+study={name}"], return_hydra_config=True)
    params = whole.hydra.sweeper.params
    assert params
    for key, values in params.items():
        for value in [] if "(" in str(values) else str(values).split(","):
            compose([f"{key}={value}"], "evaluate")


def test_jobs_are_joined_into_as_few_multiruns_as_their_differences_allow():
    jobs = [job("source=generation", f"method={m}", *s) for m in ("a", "b") for s in ((), ("seed=1",), ("seed=2",))]
    assert sweeps(jobs) == [["source=generation", "method=a,b"], ["source=generation", "method=a,b", "seed=1,2"]]
    assert sweeps([job("source=real"), job("source=shuffled")]) == [["source=real,shuffled"]]
    own = [job("source=real", "lift=true"), job("source=real"), job("source=noise", "method=a")]
    assert sweeps(own) == [["source=real", "lift=true"], ["source=real"], ["source=noise", "method=a"]]
    parts = [job("source=real", f"replications=[{i},{i + 1}]") for i in (0, 2)]
    assert sweeps(parts) == [["source=real", "replications=[0,1],[2,3]"]]


def test_replications_are_divided_among_jobs_and_none_is_scored_twice(micro, tmp_path):
    own = [*micro, "scale.protocol.replications=3", "scale.protocol.seed=11"]
    rows = plan(small("real"), own)
    row = run_evaluation(compose([*own, "source=real", "replications=[1]"], "evaluate"))
    assert row.folder.status["state"] == "partial"
    jobs = [one for one in missing_jobs(rows, own, replications=1) if one.command == EVALUATE]
    assert [one.overrides[-1] for one in jobs] == ["replications=[0]", "replications=[2]"]
    whole = Job(EVALUATE, (*own, "source=real"), rows[0].place.folder.path)
    run_jobs([*jobs, whole], 3)  # all at once
    lines = scored_lines(rows[0].place.folder.path)
    assert sorted(line["replication"] for line in lines) == [0, 1, 2]
    alone = compose([*own, "source=real", f"paths.runs={tmp_path}"], "evaluate")
    for stage, run in rows[0].place.judges.items():
        (tmp_path / stage).mkdir()
        (tmp_path / stage / run.name).symlink_to(run)
    expected = {line["replication"]: line["metrics"] for line in run_evaluation(alone).lines}
    for line in lines:
        assert line["metrics"] == pytest.approx(expected[line["replication"]], rel=1e-6)


@pytest.mark.parametrize("value", ["[]", "[2]", "1", "[0,a]"])
def test_replications_that_there_are_not_are_refused(value, micro):
    with pytest.raises(
        ValueError, match=r"replications=.*(some of 0 \.\.\. 1 |must be a list of at least 1, each a whole number)"
    ):
        describe(compose([*micro, "source=real", f"replications={value}"], "evaluate"))


def scored(place, **metrics: float) -> None:
    for replication in range(place.replications):
        facts = dict.fromkeys(("corpus", "statistics", "words", "tokens", "protocol", "device", "text_encoder"), "x")
        facts |= {"sampling": None, "evaluators": {}, "runs": {}, "seed": 0, "versions": {}}
        found = {name: value + replication for name, value in metrics.items()}
        line = {"replication": replication, "metrics": found, "breakdowns": {}, "seconds": 1.0, "provenance": facts}
        append_line(place.folder.path / "replications.jsonl", line)


def test_the_means_are_told_with_their_intervals_when_all_replications_are_there(micro, tmp_path):
    (row,) = plan(small("real"), [*micro, f"paths.runs={tmp_path}"])
    scored(row.place, fid=1.0, turn_ratio=0.5)
    with console.capture() as said:
        tell_means(row.place)
    assert said.get() == "mean      of 2: fid 1.500 ± 6.353\n"


def test_a_row_of_several_seeds_is_shown_as_one(micro, tmp_path):
    table = small("real", "mardm_sit")
    rows = plan(table, [*micro, f"paths.runs={tmp_path}"], seeds=3)
    assert [(row.spec["key"], row.seed) for row in rows] == [
        ("real", None),
        ("mardm_sit", None),
        ("mardm_sit", 1),
        ("mardm_sit", 2),
    ]
    assert len({row.place.subject["generator"] for row in rows[1:]}) == 3
    assert len({str(row.place.judges) for row in rows}) == 1  # the same judges for all seeds
    trained = [one.overrides for one in missing_jobs(rows, []) if one.overrides[0] == "stage=generator"]
    assert trained == [("stage=generator", "method=mardm_sit", *s) for s in ((), ("seed=1",), ("seed=2",))]
    for row, fid in zip(rows, (1.0, 10.0, 20.0, 40.0), strict=True):
        scored(row.place, fid=fid)
    render_table(table, plan(table, [*micro, f"paths.runs={tmp_path}"], seeds=3), tmp_path / "report", "command")
    shown = (tmp_path / "report/table.md").read_text()
    assert "n seeds: over models of that many training seeds" in shown
    line = next(line for line in shown.splitlines() if line.startswith("| MARDM-SiT | 3 seeds"))
    assert "23.833 ± 37.946" in line  # mean and t interval of 10.5, 20.5, 40.5
    assert "| Real motion | 2 |" in shown


def test_a_plan_tells_what_is_there_and_what_the_rest_took_before(micro, micro_tables, tmp_path, capsys):
    runs = f"paths.runs={tmp_path}"
    for row in plan(small("real"), [*micro, runs, "seed=5", "evaluator.seed=5"]):
        scored(row.place, fid=1.0)
    before = sorted(tmp_path.rglob("*"))
    reproduce.main(["table1", *micro, runs, "--plan", "--replications-per-job", "1"])
    said = " ".join(capsys.readouterr().out.split())
    assert "cached 0 of" in said
    assert "0 of 9 rows" in said
    assert "would run unknown kinema train stage=tokenizer" in said
    assert said.count("would run 1 s kinema evaluate") == 2  # replications like those of the other seed
    assert "replications=[1]" in said
    assert sorted(tmp_path.rglob("*")) == before
    reproduce.main(["table2", *micro_tables, runs, "--plan"])
    said = " ".join(capsys.readouterr().out.split())
    assert "scale.protocol.mm_texts=0 source=real" in said  # what the table itself says is part of the commands


def test_the_time_of_a_training_follows_from_runs_like_it(micro, tmp_path):
    runs = [*micro, f"paths.runs={tmp_path}"]
    (one,) = [j for j in missing_jobs(plan(small("mardm_sit"), runs), runs) if "stage=generator" in j.overrides]
    assert estimate(one) is None
    other = one.makes.with_name(one.makes.name.replace("-smoke-", "-tiny-"))
    for folder, status in ((other, {"seconds": 60.0, "step": 12}),):
        folder.mkdir(parents=True)
        (folder / "status.json").write_text(json.dumps({"state": "done", **status}))
        (folder / "weights.safetensors").touch()
    assert estimate(one) == pytest.approx(120)  # 24 steps at five seconds each


@pytest.mark.slow
def test_optuna_tries_what_the_results_of_val_suggest(script, tmp_path):
    pytest.importorskip("hydra_plugins.hydra_optuna_sweeper", reason="needs the extra tune")
    few = ["hydra.sweeper.n_trials=2", "scale.protocol.replications=1", f"hydra.sweep.dir={tmp_path}/sweep"]
    script("evaluate.py", "+study=guidance_optuna", "method=mardm_sit", *few, "-m")
    rows = list((tmp_path / "runs/evaluation").iterdir())
    assert len(rows) == 2
    best = min(scored_lines(row)[0]["metrics"]["fid"] for row in rows)
    assert f"best_value: {best}" in (tmp_path / "sweep/optimization_results.yaml").read_text()
    refused = script("evaluate.py", "source=real", "objective=fid", check=False)
    assert refused.returncode == 2
    assert "only val selects: set scale.protocol.split=val" in refused.stderr


def test_what_is_hydras_goes_to_the_multiruns_alone():
    given = ("data=synthetic", "launcher=slurm", "hydra.launcher.partition=gpu", "+hydra.launcher.account=me")
    given += ("hydra.sweep.dir=sweep", "hydra.searchpath=[file://conf]", "seed=1")
    request = Request("table5", given)
    assert request.shared == ["data=synthetic", "hydra.searchpath=[file://conf]", "seed=1"]
    assert request.launcher == [o for o in given if o not in request.shared]
    assert Request("table5", ("launcher=local", "hydra.sweep.dir=sweep")).launcher == []


@pytest.mark.parametrize("how", [["--plan"], []])
@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["launcher=sloorm"], "launcher=sloorm is no option; launcher has joblib, local, slurm, submitit_local"),
        (["launcher=slurm", "hydra.launcher.partitions=gpu"], "hydra.launcher.partitions"),
    ],
)
def test_a_launcher_that_there_is_not_is_told_before_anything_runs(
    words, told, how, micro, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(launching, "run_multiruns", lambda *_: pytest.fail("something ran"))
    with pytest.raises(SystemExit, match="2"):
        reproduce.main(["table5", *micro, f"paths.runs={tmp_path}", *words, *how])
    assert re.match(f"error: .*{re.escape(told)}", capsys.readouterr().err)
    assert not list(tmp_path.iterdir())


def test_slurm_that_is_not_here_is_one_line(micro, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(reproduce, "load_table", lambda name: small("real"))
    monkeypatch.setattr(launching, "run_multiruns", lambda *_: pytest.fail("something ran"))
    line = "error: launcher=slurm: there is no srun here; "
    with pytest.raises(SystemExit, match="2"):
        reproduce.main(["table5", *micro, f"paths.runs={tmp_path}/runs", "launcher=slurm"])
    assert capsys.readouterr().err.startswith(line)
    with pytest.raises(SystemExit, match="2"):
        entry.train(["-m", "seed=0,1", "launcher=slurm"])
    assert capsys.readouterr().err.startswith(line)
    reproduce.main(["table5", *micro, f"paths.runs={tmp_path}/runs", "launcher=slurm", "--plan"])


def test_a_sweep_goes_on_after_a_failed_job_and_lists_it(tmp_path, monkeypatch, capsys):
    seen = []

    def run_stage(cfg, stage):
        seen.append(cfg.seed)
        if cfg.seed == 0:
            raise ValueError("lr=3 is [too] much")
        if cfg.seed == 1:
            raise RuntimeError("out of memory")
        return RunFolder(tmp_path)

    monkeypatch.setattr(running, "run_stage", run_stage)
    with pytest.raises(SystemExit) as ended:
        entry.train(["-m", "seed=0,1,2", "stage=tokenizer", f"hydra.sweep.dir={tmp_path}/sweep"])
    assert seen == [0, 1, 2]
    assert ended.value.code == 2
    captured = capsys.readouterr()
    listed = "error: 2 of the sweep's jobs failed, the others are done:\n  seed=0: lr=3 is [too] much\n  seed=1: "
    assert captured.err.endswith(listed + "RuntimeError('out of memory')\n")
    assert "failed    lr=3 is [too] much\n" in captured.out
    assert 'raise RuntimeError("out of memory")' in captured.err


SBATCH = """#!{python}
# Be Slurm: keep the script, and start it for every task of its array once this process has answered.
import os, pathlib, re, subprocess, sys
text = pathlib.Path(sys.argv[-1]).read_text()
kept = pathlib.Path(os.environ["KEPT"])
kept.write_text(text)
for task in range(int(re.search(r"--array=0-(\\d+)", text)[1]) + 1):
    own = {{"SLURM_JOB_ID": "7", "SLURM_ARRAY_JOB_ID": "7", "SLURM_ARRAY_TASK_ID": str(task), "SLURM_PROCID": "0"}}
    own |= {{"SLURM_LOCALID": "0", "SLURM_NODEID": "0", "SLURM_NTASKS": "1", "SLURM_JOB_NUM_NODES": "1"}}
    quiet = dict.fromkeys(("stdout", "stderr"), subprocess.DEVNULL)
    subprocess.Popen(["bash", str(kept)], env={{**os.environ, **own}}, start_new_session=True, **quiet)
print("Submitted batch job 7")
"""
SRUN = """#!{python}
import os, sys
words = [w for w in sys.argv[1:] if not w.startswith("--")]
words = words[words.index(sys.executable):] if sys.executable in words else words
os.execvp(words[0], words)
"""
SACCT = """#!{python}
import os, pathlib
print("JobID|State|NodeList")
for task in range(2):
    ended = list(pathlib.Path(os.environ["KEPT"]).parent.rglob(f"7_{{task}}_*result.pkl"))
    print(f"7_{{task}}|{{'COMPLETED' if ended else 'RUNNING'}}|here")
"""


@pytest.mark.slow
def test_slurm_is_asked_for_what_the_launcher_says(script, tmp_path, monkeypatch):
    pytest.importorskip("hydra_plugins.hydra_submitit_launcher", reason="needs the extra launch")
    tools = tmp_path / "slurm"
    tools.mkdir()
    for name, text in {"sbatch": SBATCH, "srun": SRUN, "sacct": SACCT, "scontrol": SRUN}.items():
        (tools / name).write_text(text.format(python=sys.executable))
        (tools / name).chmod((tools / name).stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", f"{tools}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("KEPT", str(tmp_path / "job.sh"))
    own = ["launcher=slurm", "hydra.launcher.timeout_min=90", f"hydra.sweep.dir={tmp_path}/sweep"]
    script("train.py", "stage=decomposition,contrastive", *own, "-m")
    for stage in ("decomposition", "contrastive"):
        (run,) = (tmp_path / "runs" / stage).iterdir()
        assert json.loads((run / "status.json").read_text())["state"] == "done"
    asked = (tmp_path / "job.sh").read_text()
    for line in ("--array=0-1%", "--cpus-per-task=8", "--gpus-per-node=1", "--mem=48GB", "--time=90", "--nodes=1"):
        assert f"#SBATCH {line}" in asked, asked


@pytest.mark.slow
def test_submitit_makes_a_table_on_this_machine(micro, tmp_path, monkeypatch):
    pytest.importorskip("hydra_plugins.hydra_submitit_launcher", reason="needs the extra launch")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(reproduce, "load_table", lambda name: small("real", "shuffled"))
    own = [*micro, f"paths.runs={tmp_path}/runs", "launcher=submitit_local"]
    for _ in range(3):  # submitit starts a process before the folder that it writes to is there
        with contextlib.suppress(JobsFailedError):  # called again, it fills the gap
            reproduce.reproduce("table5", own, out=tmp_path / "report", replications=1)
            break
    rows = plan(small("real", "shuffled"), [*micro, f"paths.runs={tmp_path}/runs"])
    assert all(row.complete for row in rows)
    assert all(len(scored_lines(row.place.folder.path)) == 2 for row in rows)
    assert "| Real motion | 2 |" in (tmp_path / "report/table.md").read_text()

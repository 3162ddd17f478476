"""One job of a multirun that is killed stops no other: all are waited for, and its row says where its output is."""

from __future__ import annotations

import os
import signal
import sys

import hydra
import pytest

from kinema.experiments import multirun
from kinema.experiments.config import CONF
from kinema.experiments.jobs import TRAIN, Job, JobsFailedError
from kinema.experiments.lost import VARIABLE, LostJobs, tell_lost

pytest.importorskip("hydra_plugins.hydra_submitit_launcher", reason="needs the extra launch")


def train_job(*overrides: str, folder) -> Job:
    return Job(TRAIN, overrides, folder / "-".join(overrides))


class Executor:
    """Be submitit: the first job dies while the second is queued."""

    asked: dict
    waited: list

    def __init__(self, folder, **limits):
        Executor.asked, Executor.waited = {"folder": folder, **limits}, []

    def update_parameters(self, **options):
        Executor.asked |= options

    def map_array(self, launcher, *arguments):
        from submitit.core.utils import JobPaths, UncompletedJobError

        class Submitted:
            def __init__(self, number):
                self.job_id, self.state = f"7_{number}", "OUT_OF_MEMORY"
                self.paths = JobPaths(Executor.asked["folder"], self.job_id, 0)

            def results(self):
                Executor.waited.append(self.job_id)
                if self.job_id == "7_0":
                    self.paths.folder.mkdir(parents=True)
                    self.paths.stderr.touch()
                    raise UncompletedJobError("Job 7_0 has not produced any output\nand many more lines")
                return [hydra.core.utils.JobReturn(status=hydra.core.utils.JobStatus.COMPLETED)]

        return [Submitted(number) for number, _ in enumerate(zip(*arguments, strict=True))]


def sweep(task, *overrides: str) -> None:
    """Run a task under Hydra as `kinema train -m` does."""
    sys.argv[1:] = ["-m", *overrides]
    hydra.main(config_path=str(CONF), config_name="train", version_base="1.3")(task)()


@pytest.fixture
def lost(tmp_path, monkeypatch) -> LostJobs:
    monkeypatch.setattr(sys, "argv", ["train"])
    monkeypatch.setenv("HYDRA_FULL_ERROR", "1")
    monkeypatch.setenv(VARIABLE, str(tmp_path / "lost.jsonl"))
    return LostJobs(tmp_path / "lost.jsonl")


@pytest.mark.parametrize(("launcher", "cluster"), [("submitit_local", "local"), ("slurm", "slurm")])
def test_every_job_is_waited_for_whatever_becomes_of_one(launcher, cluster, lost, tmp_path, monkeypatch, capsys):
    import submitit

    monkeypatch.setattr(submitit, "AutoExecutor", Executor)
    log = tmp_path / "sweep/.submitit/7_0/7_0_0_log.err"
    told = f"job 7_0 ended without a result (state OUT_OF_MEMORY); its output: {log}"
    own = (f"launcher={launcher}", "hydra.launcher.timeout_min=90", f"hydra.sweep.dir={tmp_path}/sweep")
    with pytest.raises(OSError, match="job 7_0 ended without a result") as failure:
        sweep(lambda cfg: None, "seed=0,1,2", "stage=tokenizer", *own)
    assert str(failure.value) == told
    assert Executor.waited == ["7_0", "7_1", "7_2"]
    assert (Executor.asked["cluster"], Executor.asked["timeout_min"]) == (cluster, 90)
    assert Executor.asked.get("slurm_max_num_timeout") == (0 if cluster == "slurm" else None)
    assert f"seed=0 stage=tokenizer launcher={launcher}: {told}" in capsys.readouterr().out
    jobs = [train_job("stage=tokenizer", f"seed={seed}", folder=tmp_path) for seed in range(3)]
    assert lost.reasons(jobs) == {jobs[0]: told}


@pytest.mark.slow
def test_a_killed_process_leaves_the_other_its_result(lost, tmp_path, monkeypatch):
    from submitit.core.core import Job as Submitted

    monkeypatch.setattr(Submitted, "_results_timeout_s", 0)
    monkeypatch.chdir(tmp_path)
    # submitit starts a process before the folder that it writes to is there
    folder = f"hydra.launcher.submitit_folder={tmp_path}"

    def task(cfg):
        if cfg.seed == 0:
            os.kill(os.getpid(), signal.SIGKILL)
        (tmp_path / f"done-{cfg.seed}").touch()

    with pytest.raises(OSError, match="ended without a result") as failure:
        sweep(task, "seed=0,1", "launcher=submitit_local", folder)
    assert [path.name for path in tmp_path.glob("done-*")] == ["done-1"]
    (log,) = (path for path in tmp_path.glob("*_log.err") if str(failure.value).endswith(f"its output: {path}"))
    assert log.exists()


def test_what_a_launcher_lost_is_why_a_job_failed(tmp_path, monkeypatch):
    jobs = [train_job("stage=generator", *own, folder=tmp_path) for own in (("seed=0",), ("seed=1",), ())]
    jobs.append(train_job("source=real", "replications=[0,1]", folder=tmp_path))

    def run(words, environment):
        # As Hydra writes the overrides of each job anew.
        monkeypatch.setenv(VARIABLE, environment[VARIABLE])
        if "seed=0,1" in words:
            tell_lost(["data=synthetic", "stage=generator", "seed=1"], "killed")
        if "source=real" in words:
            tell_lost(["data=synthetic", "source=real", "replications=[0, 1]"], "lost")

    monkeypatch.setattr(multirun, "_run", run)
    with pytest.raises(JobsFailedError) as failure:
        multirun.run_multiruns(jobs, ["data=synthetic"])
    unknown = "it ended before it was finished; its own output says more"
    reasons = dict(zip((job.makes for job in jobs), (unknown, "killed", unknown, "lost"), strict=True))
    assert failure.value.reasons() == reasons

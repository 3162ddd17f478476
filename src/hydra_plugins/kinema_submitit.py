"""Start the jobs of a sweep by submitit and wait for every one; Hydra takes launchers from the package of this name.

The launchers that they extend stop at the first job without a result (killed, out of memory, a lost node), while others
are queued or still at work.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.singleton import Singleton
from hydra.core.utils import JobReturn, JobStatus, filter_overrides

if TYPE_CHECKING:
    from submitit import Job

try:
    from hydra_plugins.hydra_submitit_launcher.config import BaseQueueConf
    from hydra_plugins.hydra_submitit_launcher.submitit_launcher import BaseSubmititLauncher
except ImportError:  # without the extra launch; Hydra imports this module at every start
    pass
else:

    class WaitingLauncher(BaseSubmititLauncher):  # type: ignore[misc]  # it has no types
        """Hand all jobs over at once, and return what became of each."""

        def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> list[JobReturn]:
            """Run jobs of these overrides; one that ended without a result is returned as failed, with its log."""
            import submitit

            folder = self.params["submitit_folder"]
            limits = {f"{self._EXECUTOR}_{name}": self.params[name] for name in LIMITS if name in self.params}
            executor = submitit.AutoExecutor(folder, cluster=self._EXECUTOR, **limits)
            asked = {name: value for name, value in self.params.items() if name not in ("submitit_folder", *LIMITS)}
            common = BaseQueueConf.__dataclass_fields__
            executor.update_parameters(**{n if n in common else f"{self._EXECUTOR}_{n}": asked[n] for n in asked})
            self._make_sweep_dir()
            calls = []
            for number, overrides in enumerate(job_overrides, initial_job_idx):
                log.info(f"\t#{number} : {' '.join(filter_overrides(overrides))}")
                name = f"job_id_for_{number}"
                calls.append((list(overrides), "hydra.sweep.dir", number, name, Singleton.get_state()))
            jobs = executor.map_array(self, *zip(*calls, strict=True))
            return [outcome(job, overrides) for job, overrides in zip(jobs, job_overrides, strict=True)]

        def _make_sweep_dir(self) -> None:
            sweep = self.config.hydra.sweep
            log.info(f"Submitit '{self._EXECUTOR}' sweep output dir : {sweep.dir}")
            Path(sweep.dir).mkdir(parents=True, exist_ok=True)
            if "mode" in sweep:
                os.chmod(sweep.dir, int(str(sweep.mode), 8))

    class LocalLauncher(WaitingLauncher):
        """Start processes of this machine."""

        _EXECUTOR = "local"

    class SlurmLauncher(WaitingLauncher):
        """Submit an array to Slurm."""

        _EXECUTOR = "slurm"


LIMITS = ("max_num_timeout",)
"""Options that an executor is made with; all others are given to it afterwards."""

log = logging.getLogger(__name__)


def outcome(job: Job[JobReturn], overrides: Sequence[str]) -> JobReturn:
    """Wait for a job and return its result, or say as a failure where the output is of one that has none."""
    from kinema.experiments.lost import tell_lost  # here: Hydra imports this module at every start

    try:
        return job.results()[0]
    except Exception as error:  # of submitit: what a run raises is a result
        reason = f"job {job.job_id} ended without a result (state {job.state}); its output: {_output(job, error)}"
        tell_lost(overrides, reason)
        return JobReturn(overrides=list(overrides), status=JobStatus.FAILED, _return_value=OSError(reason))


def _output(job: Job[Any], error: Exception) -> Path:
    paths = job.paths
    return next((path for path in (paths.stderr, paths.stdout) if path.exists()), paths.folder)

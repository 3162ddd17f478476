"""Run jobs as Hydra multiruns, whose launcher takes them elsewhere: each step as soon as the one before it is done."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

from kinema.experiments.jobs import EVALUATE, TRAIN, Job, JobsFailedError
from kinema.experiments.lost import lost_jobs
from kinema.experiments.overrides import for_training
from kinema.runs.console import console
from kinema.signals import Interrupted, ended_by_signal, interruptible

JOINED = ("method", "seed", "replications", "stage", "source")
"""Overrides in which the jobs of one multirun may differ."""


def run_multiruns(jobs: list[Job], overrides: list[str]) -> None:
    """Run jobs under the launcher that the overrides name; the jobs' own overrides come on top.

    A job that fails leaves out those that wait for it, and no other. Raises JobsFailedError when all the rest is done,
    and Interrupted when this process or a multirun is interrupted.
    """
    failed: dict[Job, BaseException] = {}
    left_out: list[Job] = []
    unmade: set[Path] = set()
    for command, step in steps(jobs):
        waiting = [job for job in step if job.reads & unmade]
        ready = [job for job in step if job not in waiting]
        left_out += waiting
        reasons: dict[Job, str] = {}
        for choices in sweeps(ready):
            words = [command, "-m", *(for_training(overrides) if command == TRAIN else overrides), *choices]
            console.print(f"[bold]run[/]       kinema {' '.join(words)}")
            with lost_jobs() as lost:
                _run(words, lost.environment)
                reasons |= lost.reasons(job for job in ready if _names(job.overrides) == _names(choices))
        # What a launcher says comes first: in its run's folder, a job that was killed left what an earlier one wrote.
        broken = {job: OSError(reasons.get(job, why)) for job in ready if (why := job.unfinished()) is not None}
        failed |= broken
        unmade |= {job.makes for job in (*waiting, *broken)}
    if failed:
        raise JobsFailedError(failed, left_out)


def _run(words: list[str], environment: dict[str, str]) -> None:
    """Call kinema; an interrupted call interrupts this process, and the other way round."""
    # -P: a file of the user's in this directory must not be taken for a module of the same name.
    with subprocess.Popen([sys.executable, "-P", "-m", "kinema.cli", *words], env=environment) as process:
        try:
            with interruptible():
                code = process.wait()
        except Interrupted:
            process.terminate()
            raise
    if (signum := ended_by_signal(code)) is not None:
        raise Interrupted(signum)


def steps(jobs: list[Job]) -> list[tuple[str, list[Job]]]:
    """Return the jobs by command and step, upstream first: all jobs of a stage or source are one step."""
    by_path: dict[Path, list[Job]] = {}
    for job in jobs:
        by_path.setdefault(job.makes, []).append(job)

    def depth(job: Job) -> int:
        return 1 + max((depth(other) for run in job.reads for other in by_path.get(run, ())), default=0)

    level: dict[str, int] = {}
    for job in jobs:
        level[job.overrides[0]] = max(level.get(job.overrides[0], 0), depth(job))
    found: dict[tuple[int, str], list[Job]] = {}
    for job in jobs:
        found.setdefault((level[job.overrides[0]], job.command), []).append(job)
    order = (TRAIN, EVALUATE)
    return [(key[1], found[key]) for key in sorted(found, key=lambda key: (key[0], order.index(key[1])))]


def _names(overrides: Iterable[str]) -> set[str]:
    return {override.partition("=")[0] for override in overrides}


def sweeps(jobs: Iterable[Job]) -> list[list[str]]:
    """Join jobs of one command into the overrides of as few multiruns: those that differ in one of `JOINED`."""
    grids: list[dict[str, tuple[str, ...]]] = [
        {key: (value,) for key, _, value in (o.partition("=") for o in job.overrides)} for job in jobs
    ]
    for name in JOINED:
        joined: dict[tuple[tuple[str, tuple[str, ...]], ...], dict[str, tuple[str, ...]]] = {}
        for grid in grids:
            rest = tuple((key, value if key != name else ()) for key, value in grid.items())
            values = joined.setdefault(rest, dict(rest)).get(name, ()) + grid.get(name, ())
            if name in grid:
                joined[rest][name] = tuple(dict.fromkeys(values))
        grids = [*joined.values()]
    return [[f"{key}={','.join(values)}" for key, values in grid.items()] for grid in grids]

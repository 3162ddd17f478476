"""Make what a table lacks on this machine: jobs side by side, each as soon as the runs that it reads are there."""

from __future__ import annotations

import multiprocessing
import os
import shlex
import signal
import threading
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType

from omegaconf import DictConfig

from kinema.experiments.config import compose, refuse_processes
from kinema.experiments.corpus import files_listed_once
from kinema.experiments.overrides import for_training
from kinema.experiments.replications import whole_lines
from kinema.experiments.run import stage_folder
from kinema.experiments.stages import companions_of, get_stage, needs_of
from kinema.experiments.stages.base import Stage
from kinema.experiments.tables import TableRow
from kinema.runs.console import console
from kinema.runs.folder import RunFolder
from kinema.signals import Interrupted, interruptible

TRAIN, EVALUATE = "train", "evaluate"
FAREWELL = 2.0
"""Seconds in which an interrupted process hands on what it has to say."""


@dataclass(frozen=True)
class Job:
    """Hold one call of `kinema train` or `kinema evaluate`: the folder it finishes, and those it waits for.

    Of an evaluation, `replications` are those to score, with the scores of all `judges`.
    """

    command: str
    overrides: tuple[str, ...]
    makes: Path
    reads: frozenset[Path] = frozenset()
    replications: tuple[int, ...] = ()
    judges: frozenset[str] = frozenset()

    def unfinished(self) -> str | None:
        """Say why it isn't finished; None if it is."""
        if self.command == TRAIN:
            there = RunFolder(self.makes).done
        else:
            there = set(self.replications) <= {line["replication"] for line in whole_lines(self.makes, self.judges)}
        if there:
            return None
        return RunFolder(self.makes).status.get("error") or "it ended before it was finished; its own output says more"

    def __str__(self) -> str:
        return shlex.join(["kinema", self.command, *self.overrides])


def missing_jobs(rows: Iterable[TableRow], shared: Sequence[str] = (), replications: int | None = None) -> list[Job]:
    """Return a job for each run and each scored row that is lacking, each run once; what most wait for comes first.

    A row is one job, or one for so many `replications` each.
    """
    jobs: dict[Path, Job] = {}
    scored: dict[Path, list[Job]] = {}
    for row in rows:
        if row.cfg is None or row.place is None or row.complete:
            continue
        trained = [*shared, *row.trained]
        reads = set()
        for name, path in row.place.runs.items():
            if _add_stage(jobs, row.cfg, get_stage(name), trained) is not None:
                reads.add(path)
        place, own = row.place, (*shared, *row.overrides)
        judges = frozenset(place.judges)
        whole = Job(EVALUATE, own, place.folder.path, frozenset(reads), place.missing, judges)
        scored[whole.makes] = _divided(whole, replications)
    return [*_longest_first(jobs), *(job for parts in scored.values() for job in parts)]


def _divided(job: Job, size: int | None) -> list[Job]:
    if size is None:
        return [job]
    parts = [job.replications[i : i + size] for i in range(0, len(job.replications), size)]
    own = [f"replications=[{','.join(map(str, part))}]" for part in parts]
    return [replace(job, overrides=(*job.overrides, o), replications=p) for o, p in zip(own, parts, strict=True)]


def missing_runs(wanted: Iterable[tuple[DictConfig, Stage, list[str]]]) -> list[Job]:
    """Return a job for each lacking run of some stages, (configuration, stage, overrides), and of what they read."""
    jobs: dict[Path, Job] = {}
    for cfg, stage, overrides in wanted:
        _add_stage(jobs, cfg, stage, overrides)
    return _longest_first(jobs)


def _longest_first(jobs: dict[Path, Job]) -> list[Job]:
    return sorted(jobs.values(), key=lambda job: -_height(job, jobs))


def _add_stage(jobs: dict[Path, Job], cfg: DictConfig, stage: Stage, overrides: list[str]) -> Path | None:
    """Add the jobs that make a stage's run and those behind and beside it; None if it is there or given."""
    if not stage.present(cfg) or stage.given(cfg) is not None:
        return None
    run = stage_folder(cfg, stage)
    if run.done:
        return None
    if run.path not in jobs:
        before = (*needs_of(stage), *companions_of(stage), *stage.watched_by(cfg))
        wanted = (_add_stage(jobs, cfg, other, overrides) for other in before)
        reads = frozenset(path for path in wanted if path is not None)
        jobs[run.path] = Job(TRAIN, (f"stage={stage.name}", *for_training(overrides)), run.path, reads)
    return run.path


def _height(job: Job, jobs: dict[Path, Job]) -> int:
    """Count the longest chain of jobs that waits for this one."""
    waiting = [other for other in jobs.values() if job.makes in other.reads]
    return 1 + max((_height(other, jobs) for other in waiting), default=0)


def processes(cfg: DictConfig) -> int:
    """Choose how many jobs run side by side: one a core where each takes one thread of a CPU, else one."""
    from kinema.experiments.instantiate import machine_of

    if cfg.trainer.threads != 1 or machine_of(cfg).device().type != "cpu":
        return 1
    # Cores that this process may use, which in a container are fewer than the machine has.
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class JobsFailedError(OSError):
    """Say which jobs failed, each with its error, and which were left out since they wait for one that did."""

    def __init__(self, failed: dict[Job, BaseException], left_out: list[Job]) -> None:
        self.failed, self.left_out = failed, left_out
        (job, error), *others = failed.items()
        more = "".join(f"\n`{job}` failed: {error}" for job, error in others)
        waits = f"; {len(left_out)} more wait for what failed" if left_out else ""
        super().__init__(
            f"`{job}` failed: {error}{more}{waits}; what is finished is kept: run the same command again after mending "
            "the cause"
        )

    def reasons(self) -> dict[Path, str]:
        """Return why each folder wasn't finished."""
        found = {job.makes: _first_line(error) for job, error in self.failed.items()}
        for job in self.left_out:
            reasons = sorted({found[path] for path in job.reads if path in found})
            found[job.makes] = "; ".join(reasons) or "left out: the processes that make runs were stopped"
        return found


def run_jobs(jobs: list[Job], count: int) -> None:
    """Run jobs in `count` processes that stay for all of them, so that imports are paid once.

    A job that fails leaves out those that wait for it, and no other. Raises JobsFailedError when all the rest is done,
    and Interrupted, once all processes have ended, when this one or a job is interrupted.
    """
    waiting, unfinished = list(jobs), {job.makes for job in jobs}
    running: dict[Future[None], Job] = {}
    failed: dict[Job, BaseException] = {}
    left_out: list[Job] = []
    # Spawned, not forked: torch's threads would not survive a fork.
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(count, spawn, initializer=_listen) as pool, _ended_with_this_one():
        while running or waiting:
            ready = [job for job in waiting if not job.reads & unfinished]
            # What another process works on comes last: two tables at once share the work instead of waiting in line.
            ready.sort(key=lambda job: RunFolder(job.makes).held)
            for job in ready[: count - len(running)]:
                waiting.remove(job)
                console.print(f"[bold]run[/]       {job}")
                running[pool.submit(work, job, quiet=count > 1)] = job
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                job = running.pop(future)
                if (error := future.exception()) is None:
                    unfinished.discard(job.makes)
                    continue
                if isinstance(error, Interrupted):
                    raise error
                console.print(f"[red]failed[/]    {job}: {_first_line(error)}")
                failed[job] = error
                # A process that was killed (for its memory, say) takes the pool with it.
                lost = waiting if isinstance(error, BrokenExecutor) else _waiting_for(job, waiting)
                left_out += lost
                waiting = [other for other in waiting if other not in lost]
    if failed:
        raise JobsFailedError(failed, left_out) from next(iter(failed.values()))


@contextmanager
def _ended_with_this_one() -> Iterator[None]:
    """End the processes of the pool in order when this one is interrupted: none goes on alone."""
    try:
        with interruptible():
            yield
    except Interrupted:
        for process in multiprocessing.active_children():
            process.terminate()
        raise


def _listen() -> None:
    """Let this process of the pool be ended in order: one that died while it waits would hold the pool's lock."""
    told = _Once()
    for signum in (signal.SIGTERM, signal.SIGINT):
        signal.signal(signum, told)


class _Once:
    """Interrupt at the first signal; the pool and the terminal may send more while a job is being ended."""

    def __init__(self) -> None:
        self.came = False

    def __call__(self, signum: int, _: FrameType | None) -> None:
        if not self.came:
            self.came = True
            raise Interrupted(signum)


def _waiting_for(job: Job, waiting: list[Job]) -> list[Job]:
    """Return the jobs that read what a job makes, and those that read what they make."""
    found: list[Job] = []
    lost = {job.makes}
    while more := [other for other in waiting if other not in found and other.reads & lost]:
        found += more
        lost |= {other.makes for other in more}
    return found


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


def work(job: Job, *, quiet: bool) -> None:
    """Do one job in this process; `quiet`: without a progress bar, since others print too."""
    try:
        _work(job, ["trainer.progress=none"] if quiet else [])
    except Interrupted as stop:
        # A pool that has lost a process waits for the others and tells them nothing: once this is handed on, end.
        leave = threading.Timer(FAREWELL, os._exit, (stop.code,))
        leave.daemon = True
        leave.start()
        raise


def _work(job: Job, bars: list[str]) -> None:
    with interruptible(), files_listed_once():
        cfg = compose([*bars, *job.overrides], job.command)
        refuse_processes(cfg, multirun=True)
        if job.command == TRAIN:
            from kinema.experiments.run import run_stage

            run_stage(cfg, cfg.stage)
        else:
            from kinema.experiments.evaluation import run_evaluation

            run_evaluation(cfg)

"""Reproduce a table: run what its rows lack, on this machine or as Hydra multiruns of a launcher, then render it.

`kinema reproduce table5 data=open_mocap scale=tiny [launcher=slurm] [--render-only]`; studies (conf/study) alike.
"""

from __future__ import annotations

import argparse
import shlex
import subprocess
import sys
from collections.abc import Iterable
from itertools import product
from pathlib import Path

from kinema.experiments.dashboards import show_table
from kinema.experiments.identity import fingerprint
from kinema.experiments.jobs import EVALUATE, TRAIN, Job, JobsFailedError, missing_jobs, processes, run_jobs
from kinema.experiments.studies import reproduce_study, studies
from kinema.experiments.tables import TableRow, load_table, plan, render_table
from kinema.report.intervals import FORMS, Form
from kinema.runs.console import console
from kinema.runs.folder import RunFolder
from kinema.runs.parts import upstream


def main(arguments: list[str] | None = None) -> None:
    """Parse the command line and reproduce the table."""
    parser = argparse.ArgumentParser(prog="kinema reproduce", description=__doc__)
    parser.add_argument("table", help="a file of conf/table or conf/study, for instance table5")
    parser.add_argument("overrides", nargs="*", help="Hydra overrides for all runs: data=... scale=... launcher=...")
    parser.add_argument("--render-only", action="store_true", help="render what there is; run nothing")
    parser.add_argument(
        "--jobs", type=int, help="processes side by side on this machine (default: one a core of a CPU)"
    )
    parser.add_argument("--out", type=Path, help="folder of the report (default: reports/TABLE)")
    parser.add_argument("--intervals", choices=FORMS, help="the 95 %% interval: Student's t, or 1.96 std / sqrt(n)")
    options = vars(parser.parse_intermixed_args(arguments))
    try:
        reproduce(options.pop("table"), options.pop("overrides"), **options)
    except (ValueError, OSError, ImportError) as error:
        sys.exit(f"error: {error}")


def reproduce(
    name: str,
    overrides: list[str],
    *,
    render_only: bool = False,
    jobs: int | None = None,
    out: Path | None = None,
    intervals: Form | None = None,
) -> None:
    """Run the missing stages and replications of a table (or what a study lacks) and render it.

    What fails is said in its row; the rest is made and rendered before JobsFailedError is raised.
    """
    if name in studies():
        if intervals is not None:
            raise ValueError(f"--intervals is an option of tables; the study {name} says how its own are computed")
        for path in reproduce_study(name, overrides, render_only=render_only, jobs=jobs, out=out):
            console.print(f"wrote     {path}")
        return
    table = load_table(name)
    if intervals is not None:
        table["intervals"] = intervals
    shared = [o for o in overrides if not o.startswith("launcher=")]
    rows = plan(table, shared)
    failure: JobsFailedError | None = None
    if not render_only and any(row.cfg is not None and not row.complete for row in rows):
        try:
            run_missing(rows, overrides, [*table.get("overrides", []), f"logger.group={name}"], jobs)
        except JobsFailedError as error:
            failure = error
        rows = plan(table, shared)
        rows = rows if failure is None else [row.explained(failure.reasons()) for row in rows]
    out = out or Path("reports") / name
    written = render_table(table, rows, out, shlex.join(["kinema", "reproduce", name, *shared]))
    for path in written:
        console.print(f"wrote     {path}")
    show_table(next(row.cfg for row in rows if row.cfg is not None), name, fingerprint([name, *shared]), written)
    lacking = [row.spec["label"] for row in rows if row.cfg is not None and not row.complete]
    if lacking:
        console.print(f"[yellow]empty[/]     no complete results for: {', '.join(lacking)}")
    console.print(f"seconds   {total_seconds(rows):.0f} recorded for all stages and replications of this table")
    if failure is not None:
        raise failure


def run_missing(rows: list[TableRow], overrides: list[str], own: list[str], jobs: int | None) -> None:
    """Run what is missing under the caller's overrides and the table's own: here, or by the launcher they name."""
    shared = [o for o in overrides if not o.startswith("launcher=")]
    if set(overrides) - set(shared) <= {"launcher=none"}:
        run_here(rows, [*shared, *own], jobs)
    else:
        run_multiruns(rows, [*overrides, *own])


def run_here(rows: list[TableRow], overrides: list[str], count: int | None) -> None:
    """Run what is missing in processes of this machine."""
    count = count or processes(next(row.cfg for row in rows if row.cfg is not None))
    run_jobs(missing_jobs(rows, overrides), count)


def run_multiruns(rows: list[TableRow], overrides: list[str]) -> None:
    """Run what is missing as Hydra multiruns, whose launcher takes the jobs elsewhere."""
    for job, choices in missing_work(rows):
        words = [job, "-m", *overrides, *choices]
        console.print(f"[bold]run[/]       kinema {' '.join(words)}")
        # -P: a file of the user's in this directory must not be taken for a module of the same name.
        if subprocess.run([sys.executable, "-P", "-m", "kinema.cli", *words]).returncode:
            raise OSError(
                f"`kinema {' '.join(words)}` failed (see above); what is finished is kept: run the same command again "
                "after mending the cause"
            )


def missing_work(rows: list[TableRow]) -> list[tuple[str, list[str]]]:
    """Return the multiruns that a table still needs, upstream first; none when everything is there."""
    jobs = missing_jobs(rows, [])
    depth: dict[Path, int] = {}
    level: dict[str, int] = {}  # of a stage or source: all its jobs are one step
    for job in jobs:
        depth[job.makes] = 1 + max((depth[run] for run in job.reads), default=0)
        what = job.overrides[0]
        level[what] = max(level.get(what, 0), depth[job.makes])
    steps = sorted(product(set(level.values()), (TRAIN, EVALUATE)), key=lambda step: step[0])
    return [
        (command, choices)
        for number, command in steps
        for choices in sweeps(job for job in jobs if (level[job.overrides[0]], job.command) == (number, command))
    ]


def sweeps(jobs: Iterable[Job]) -> list[list[str]]:
    """Join jobs of one command: those that differ in their method, and then in their stage or source."""
    methods: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for job in jobs:
        what, *rest = job.overrides
        own = [o for o in rest if o.startswith("method=")]
        extra = tuple(o for o in rest if o not in own)
        methods.setdefault((what, extra), []).extend(o.split("=")[1] for o in own)
    joined: dict[tuple[tuple[str, ...], tuple[str, ...]], list[str]] = {}
    for (what, extra), names in methods.items():
        joined.setdefault((tuple(names), extra), []).append(what)
    found = []
    for (chosen, extra), whats in joined.items():
        key, values = whats[0].split("=")[0], [what.split("=")[1] for what in whats]
        found.append([f"{key}={','.join(values)}", *([f"method={','.join(chosen)}"] if chosen else []), *extra])
    return found


def total_seconds(rows: list[TableRow]) -> float:
    """Add the recorded seconds of every run and replication behind the table, each once."""
    runs = {path for row in rows if row.place for path in row.place.runs.values()}
    runs |= {path for run in list(runs) for path in upstream(run).values()}
    training = sum(RunFolder(path).status.get("seconds", 0.0) for path in {p.resolve() for p in runs})
    places = {row.place.folder.path: row.place for row in rows if row.place}
    return training + sum(line["seconds"] for place in places.values() for line in place.lines)

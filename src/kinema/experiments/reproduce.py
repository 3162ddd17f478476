"""Reproduce tables: run what their rows lack, on this machine or as Hydra multiruns of a launcher, then render them.

`kinema reproduce table5 data=open_mocap scale=tiny [launcher=slurm] [--render-only]`; pages (conf/page) alike. Of
several names (`kinema reproduce table1 table2 data=...`) the tables' jobs share one set of processes: none stands idle
at a table's end.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from kinema.experiments.config import compose, plain
from kinema.experiments.corpus import files_listed_once
from kinema.experiments.dashboards import show_page, show_table
from kinema.experiments.evaluation import Row, check_reads
from kinema.experiments.identity import fingerprint
from kinema.experiments.jobs import Job, JobsFailedError, missing_jobs, processes, run_jobs
from kinema.experiments.launching import run_missing
from kinema.experiments.pages import make_page, pages
from kinema.experiments.plan import print_plan
from kinema.experiments.refusals import refusals
from kinema.experiments.request import Request
from kinema.experiments.table_files import load_table
from kinema.experiments.tables import TableRow, meant_for, plan, render_table
from kinema.report.index import write_site
from kinema.report.intervals import FORMS
from kinema.runs.console import console, printable
from kinema.runs.folder import RunFolder
from kinema.runs.parts import upstream
from kinema.signals import Interrupted, interruptible


@refusals()
def main(arguments: list[str] | None = None) -> None:
    """Parse the command line and reproduce the tables and pages; exit 2 with one line for what fails."""
    parser = argparse.ArgumentParser(prog="kinema reproduce", description=__doc__)
    parser.add_argument("name", help="a file of conf/table or conf/page, for instance table5")
    more = "more names, and Hydra overrides for all runs: data=... scale=... launcher=..."
    parser.add_argument("overrides", nargs="*", metavar="name|override", help=more)
    parser.add_argument("--plan", action="store_true", help="print what would run, and how long it took before")
    parser.add_argument("--render-only", action="store_true", help="render what there is; run nothing")
    parser.add_argument(
        "--jobs", type=int, help="processes side by side on this machine (default: one a core of a CPU)"
    )
    parser.add_argument("--out", type=Path, help="folder of the report (default: reports/NAME)")
    parser.add_argument("--seeds", type=int, default=1, help="train every method with so many seeds")
    parser.add_argument(
        "--replications-per-job",
        type=int,
        dest="replications",
        metavar="N",
        help="score a row in jobs of N replications (default: all in one)",
    )
    parser.add_argument("--intervals", choices=FORMS, help="the 95 %% interval: Student's t, or 1.96 std / sqrt(n)")
    options = vars(parser.parse_intermixed_args(arguments))
    words = options.pop("overrides")
    overrides = [word for word in words if "=" in word or word.startswith("~")]
    names = [options.pop("name"), *(word for word in words if word not in overrides)]
    try:
        with interruptible(), files_listed_once():
            reproduce_all(names, overrides, **options)
    except Interrupted as stop:
        print(f"stopped   {stop}; what is finished is kept", file=sys.stderr)
        raise
    except (ValueError, OSError, ImportError) as error:
        sys.exit(f"error: {printable(str(error))}")


def reproduce(name: str, overrides: list[str], **options: Any) -> None:
    """Run what a table or page lacks and render it; options as of Request.

    What fails is said in its row; the rest is made and rendered before JobsFailedError is raised. Without `out` the
    report goes to reports/, and the site over all that lies there is written anew.
    """
    _reproduce(Request(name, tuple(overrides), **options))


def reproduce_all(names: list[str], overrides: list[str], **options: Any) -> None:
    """Reproduce several: on this machine what the tables lack is run in one set of processes, then each is rendered.

    Beside tables, pages have none of the options that are tables' alone. What fails doesn't keep the others from being
    made; the first failure is raised when all are.
    """
    requests = [Request(name, tuple(overrides), **options) for name in names]
    first = requests[0]
    if len(requests) == 1:
        _reproduce(first)
        return
    if first.out is not None:
        raise ValueError("--out is the folder of one report; leave it out, or give one name")
    tables = [request for request in requests if request.name not in pages()]
    together = not (first.plan or first.render_only or first.launcher)
    made = _run_together(tables) if together else None
    failures = [made] if made is not None else []
    for request in requests:
        try:
            if request not in tables:
                _reproduce_page(replace(request, seeds=1, intervals=None))
            elif together:
                _reproduce_table(replace(request, render_only=True), made)
            else:
                _reproduce_table(request)
        except JobsFailedError as error:
            failures.append(error)
    if failures:
        raise failures[0]


def _run_together(requests: list[Request]) -> JobsFailedError | None:
    """Run what the tables lack, each job once; return what failed."""
    jobs: dict[tuple[Path, tuple[int, ...], frozenset[str]], Job] = {}
    planned: list[TableRow] = []
    count = 1
    for request in requests:
        table = load_table(request.name)
        if not meant_for(table, request.shared):
            continue
        rows = plan(table, request.shared, request.seeds)
        for job in missing_jobs(rows, [*request.shared, *_own(table, request)], request.replications):
            jobs.setdefault((job.makes, job.replications, job.judges), job)
        count = request.jobs or processes(next(row.cfg for row in rows if row.cfg is not None))
        planned += rows
    check_files(planned)
    try:
        run_jobs(list(jobs.values()), count)
    except JobsFailedError as error:
        return error
    return None


def check_files(rows: list[TableRow]) -> None:
    """Find the text encoders and vocabularies that incomplete rows read, each once, before anything is trained.

    Raises what is raised where they are read.
    """
    asked: dict[str, tuple[DictConfig, Row]] = {}
    for row in rows:
        if row.cfg is not None and row.place is not None and not row.complete:
            reads = {"text": plain(row.cfg.text), "evaluator": plain(row.cfg.evaluator), "source": row.cfg.source}
            asked.setdefault(fingerprint([reads, sorted(row.place.judges)]), (row.cfg, row.place))
    for cfg, place in asked.values():
        check_reads(cfg, place)


def _own(table: dict[str, Any], request: Request) -> list[str]:
    """The overrides that a table gives its runs: those of its file, and the dashboards' group."""
    return [*table.get("overrides", []), f"logger.group={request.name}"]


def _reproduce(request: Request) -> None:
    return _reproduce_page(request) if request.name in pages() else _reproduce_table(request)


def _reproduce_page(request: Request) -> None:
    if request.plan:
        console.print(f"plan      {request.name} is a page: what it lacks is known when it is made")
        return
    written = make_page(request)
    _tell_written(written, request)
    show_page(compose(request.shared, "evaluate"), request.name, fingerprint(request.command), written)


def _reproduce_table(request: Request, made: JobsFailedError | None = None) -> None:
    """Render a table, after running what it lacks; `made` has failed before, with other tables' jobs."""
    table = load_table(request.name)
    if not meant_for(table, request.shared):
        console.print(f"skipped   {request.name} is a table of data={', data='.join(table['only'])} alone")
        return
    if request.intervals is not None:
        table["intervals"] = request.intervals
    if request.launcher:
        compose([*request.shared, *request.launcher])  # tells an unknown launcher, or option of it, before all else
    rows, own = plan(table, request.shared, request.seeds), _own(table, request)
    if request.plan:
        try:
            check_files(rows)
        except (OSError, ValueError, ImportError) as error:
            console.print(f"[yellow]lacking[/]   {error}")
        print_plan(missing_jobs(rows, [*request.shared, *table.get("overrides", [])], request.replications), rows)
        return
    failure: JobsFailedError | None = None
    if not request.render_only and any(row.cfg is not None and not row.complete for row in rows):
        check_files(rows)
        try:
            run_missing(rows, own, request)
        except JobsFailedError as error:
            failure = error
        rows = plan(table, request.shared, request.seeds)
    told = failure or made
    rows = rows if told is None else [row.explained(told.reasons()) for row in rows]
    written = render_table(table, rows, request.folder(), request.command)
    _tell_written(written, request)
    some = next(row.cfg for row in rows if row.cfg is not None)
    show_table(some, request.name, fingerprint(request.command), written)
    lacking = [row.label for row in rows if row.cfg is not None and not row.complete]
    if lacking:
        looked = Path(some.paths.runs).absolute()
        console.print(f"[yellow]empty[/]     no complete results for: {', '.join(lacking)} (in {looked})")
    console.print(f"seconds   {total_seconds(rows):.0f} recorded for all stages and replications of this table")
    if failure is not None:
        raise failure


def _tell_written(paths: list[Path], request: Request) -> None:
    """Name what was written; the site over reports/ follows, unless the report went elsewhere."""
    for path in paths:
        console.print(f"wrote     {path}")
    if request.out is None:
        write_site("reports")


def total_seconds(rows: list[TableRow]) -> float:
    """Add the recorded seconds of every run and replication behind the table, each once."""
    runs = {path for row in rows if row.place for path in row.place.runs.values()}
    runs |= {path for run in list(runs) for path in upstream(run).values()}
    training = sum(RunFolder(path).status.get("seconds", 0.0) for path in {p.resolve() for p in runs})
    places = {row.place.folder.path: row.place for row in rows if row.place}
    return training + sum(line["seconds"] for place in places.values() for line in place.lines)

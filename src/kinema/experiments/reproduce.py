"""Reproduce a table: run what its rows lack, on this machine or as Hydra multiruns of a launcher, then render it.

`kinema reproduce table5 data=open_mocap scale=tiny [launcher=slurm] [--render-only]`
"""

from __future__ import annotations

import argparse
import shlex
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

from omegaconf import DictConfig

from kinema.data.store import PackedStore
from kinema.experiments.corpus import open_corpus
from kinema.experiments.jobs import missing_jobs, processes, run_jobs
from kinema.experiments.run import stage_folder
from kinema.experiments.stages import get_stage, levels, needs_of
from kinema.experiments.stages.base import Stage
from kinema.experiments.tables import TableRow, load_table, plan, render_table, trained_by
from kinema.runs.console import console
from kinema.runs.folder import RunFolder
from kinema.runs.parts import upstream


def main(arguments: list[str] | None = None) -> None:
    """Parse the command line and reproduce the table."""
    parser = argparse.ArgumentParser(prog="kinema reproduce", description=__doc__)
    parser.add_argument("table", help="a file of conf/table, for instance table5")
    parser.add_argument("overrides", nargs="*", help="Hydra overrides for all runs: data=... scale=... launcher=...")
    parser.add_argument("--render-only", action="store_true", help="render what there is; run nothing")
    parser.add_argument(
        "--jobs", type=int, help="processes side by side on this machine (default: one a core of a CPU)"
    )
    parser.add_argument("--out", type=Path, help="folder of the report (default: reports/TABLE)")
    options = parser.parse_intermixed_args(arguments)
    try:
        reproduce(options.table, options.overrides, render_only=options.render_only, jobs=options.jobs, out=options.out)
    except (ValueError, OSError, ImportError) as error:
        sys.exit(f"error: {error}")


def reproduce(
    name: str, overrides: list[str], *, render_only: bool = False, jobs: int | None = None, out: Path | None = None
) -> None:
    """Run the missing stages and replications of a table and render it."""
    table = load_table(name)
    shared = [o for o in overrides if not o.startswith("launcher=")]
    rows = plan(table, shared)
    if not render_only and any(row.cfg is not None and not row.complete for row in rows):
        if set(overrides) - set(shared) <= {"launcher=none"}:
            run_here(rows, [*shared, *table.get("overrides", [])], jobs)
        else:
            run_multiruns(rows, [*overrides, *table.get("overrides", [])])
        rows = plan(table, shared)
    out = out or Path("reports") / name
    for path in render_table(table, rows, out, shlex.join(["kinema", "reproduce", name, *shared])):
        console.print(f"wrote     {path}")
    lacking = [row.spec["label"] for row in rows if row.cfg is not None and not row.complete]
    if lacking:
        console.print(f"[yellow]empty[/]     no complete results for: {', '.join(lacking)}")
    console.print(f"seconds   {total_seconds(rows):.0f} recorded for all stages and replications of this table")


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
    ours = [row for row in rows if row.cfg is not None and not row.complete]
    groups: dict[tuple[str, ...], tuple[list[str], list[str]]] = {}
    for row in ours:
        source, method = row.spec["source"], row.spec.get("method")
        # Rows without a method are one multirun over sources, the others one over methods for each source.
        key = (source if method else "", *row.spec.get("overrides", []))
        sources, methods = groups.setdefault(key, ([], []))
        if source not in sources:
            sources.append(source)
        if method and method not in methods:
            methods.append(method)
    scored = [("evaluate", _sweep("source", s, m, extra)) for (_, *extra), (s, m) in groups.items()]
    return [*missing_stages(ours), *scored]


def missing_stages(rows: list[TableRow]) -> list[tuple[str, list[str]]]:
    """Return the multiruns of the runs that rows lack: each run once, and after those that it reads."""
    jobs: dict[Path, tuple[str, str | None, tuple[str, ...]]] = {}
    for row in rows:
        if row.cfg is None or row.place is None:
            continue
        for name in row.place.runs:
            for run, stage in _unmade(row.cfg, get_stage(name)).items():
                jobs.setdefault(
                    run,
                    (stage, row.spec.get("method"), tuple(trained_by(row))),
                )
    work = []
    for level in levels():
        methods: dict[tuple[str, tuple[str, ...]], list[str]] = {}
        for name, method, extra in jobs.values():
            if get_stage(name) in level:
                methods.setdefault((name, extra), []).extend([method] if method else [])
        sweeps: dict[tuple[tuple[str, ...], tuple[str, ...]], list[str]] = {}
        for (name, extra), chosen in methods.items():
            sweeps.setdefault((tuple(chosen), extra), []).append(name)
        work += [("train", _sweep("stage", names, chosen, extra)) for (chosen, extra), names in sweeps.items()]
    return work


def _unmade(cfg: DictConfig, stage: Stage) -> dict[Path, str]:
    """Find a stage's run, and those behind it, that aren't finished."""
    if not stage.present(cfg) or stage.given(cfg) is not None:
        return {}
    run = stage_folder(cfg, stage, PackedStore.open(open_corpus(cfg)).hash)
    if run.done:
        return {}
    found = {run.path: stage.name}
    for needed in needs_of(stage):
        found |= _unmade(cfg, needed)
    return found


def _sweep(key: str, values: Iterable[str], methods: Iterable[str], extra: Iterable[str]) -> list[str]:
    """Return the choices of one multirun: all the values for all the methods."""
    choice = [f"method={','.join(methods)}"] if methods else []
    return [f"{key}={','.join(values)}", *choice, *extra]


def total_seconds(rows: list[TableRow]) -> float:
    """Add the recorded seconds of every run and replication behind the table, each once."""
    runs = {path for row in rows if row.place for path in row.place.runs.values()}
    runs |= {path for run in list(runs) for path in upstream(run).values()}
    training = sum(RunFolder(path).status.get("seconds", 0.0) for path in {p.resolve() for p in runs})
    places = {row.place.folder.path: row.place for row in rows if row.place}
    return training + sum(line["seconds"] for place in places.values() for line in place.lines)

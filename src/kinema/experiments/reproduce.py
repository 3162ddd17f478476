"""Reproduce a table: run what its rows lack as Hydra multiruns, then render it.

`kinema reproduce table5 data=open_mocap scale=tiny [launcher=slurm] [--render-only]`
"""

from __future__ import annotations

import argparse
import shlex
import subprocess
import sys
from pathlib import Path

from kinema.experiments.tables import TableRow, load_table, plan, render_table
from kinema.runs.console import console
from kinema.runs.folder import RunFolder
from kinema.runs.parts import upstream


def main(arguments: list[str] | None = None) -> None:
    """Parse the command line and reproduce the table."""
    parser = argparse.ArgumentParser(prog="kinema reproduce", description=__doc__)
    parser.add_argument("table", help="a file of conf/table, for instance table5")
    parser.add_argument("overrides", nargs="*", help="Hydra overrides for all runs: data=... scale=... launcher=...")
    parser.add_argument("--render-only", action="store_true", help="render what there is; run nothing")
    parser.add_argument("--out", type=Path, help="folder of the report (default: reports/TABLE)")
    options = parser.parse_intermixed_args(arguments)
    try:
        reproduce(options.table, options.overrides, render_only=options.render_only, out=options.out)
    except (ValueError, OSError, ImportError) as error:
        sys.exit(f"error: {error}")


def reproduce(name: str, overrides: list[str], *, render_only: bool = False, out: Path | None = None) -> None:
    """Run the missing stages and replications of a table and render it."""
    table = load_table(name)
    shared = [o for o in overrides if not o.startswith("launcher=")]
    overrides = [*overrides, *table.get("overrides", [])]
    rows = plan(table, shared)
    work = [] if render_only else missing_work(rows)
    if work:
        for job, choices in work:
            words = [job, "-m", *overrides, *choices]
            console.print(f"[bold]run[/]       kinema {' '.join(words)}")
            # -P: a file of the user's in this directory must not be taken for a module of the same name.
            if subprocess.run([sys.executable, "-P", "-m", "kinema.cli", *words]).returncode:
                raise OSError(
                    f"`kinema {' '.join(words)}` failed (see above); what is finished is "
                    "kept: run the same command again after mending the cause"
                )
        rows = plan(table, shared)
    out = out or Path("reports") / name
    for path in render_table(table, rows, out, shlex.join(["kinema", "reproduce", name, *shared])):
        console.print(f"wrote     {path}")
    lacking = [row.spec["label"] for row in rows if row.cfg is not None and not row.complete]
    if lacking:
        console.print(f"[yellow]empty[/]     no complete results for: {', '.join(lacking)}")
    console.print(f"seconds   {total_seconds(rows):.0f} recorded for all stages and replications of this table")


def missing_work(rows: list[TableRow]) -> list[tuple[str, list[str]]]:
    """Return the multiruns that a table still needs, upstream first; none when everything is there."""
    ours = [row for row in rows if row.cfg is not None and not row.complete]
    work: list[tuple[str, list[str]]] = []
    for stages in (("matching", "contrastive"), ("tokenizer",), ("generator",)):
        lacking = [row for row in ours if any(_lacks(row, s) for s in stages)]
        methods = sorted({row.spec["method"] for row in lacking if "method" in row.spec})
        if stages[0] == "matching" and lacking:
            work.append(("train", [f"stage={','.join(stages)}"]))
        elif methods:
            work.append(("train", [f"stage={','.join(stages)}", f"method={','.join(methods)}"]))
    groups: dict[tuple, tuple[list[str], list[str]]] = {}
    for row in ours:
        source, method = row.spec["source"], row.spec.get("method")
        # Rows without a method are one multirun over sources, the others one over methods for each source.
        key = (source if method else None, *row.spec.get("overrides", []))
        sources, methods = groups.setdefault(key, ([], []))
        if source not in sources:
            sources.append(source)
        if method and method not in methods:
            methods.append(method)
    for (_, *extra), (sources, methods) in groups.items():
        choice = [f"method={','.join(methods)}"] if methods else []
        work.append(("evaluate", [f"source={','.join(sources)}", *choice, *extra]))
    return work


def _lacks(row: TableRow, stage: str) -> bool:
    run = row.place.runs.get(stage)
    if stage == "tokenizer" and "generator" in row.place.runs:
        return not RunFolder(row.place.runs["generator"]).done
    return run is not None and not RunFolder(run).done


def total_seconds(rows: list[TableRow]) -> float:
    """Add the recorded seconds of every run and replication behind the table, each once."""
    runs = {path for row in rows if row.place for path in row.place.runs.values()}
    runs |= {path for run in list(runs) for path in upstream(run).values()}
    training = sum(RunFolder(path).status.get("seconds", 0.0) for path in {p.resolve() for p in runs})
    places = {row.place.folder.path: row.place for row in rows if row.place}
    return training + sum(line["seconds"] for place in places.values() for line in place.lines)

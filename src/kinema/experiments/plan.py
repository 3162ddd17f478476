"""Say what a table would run, what is there already, and how long the rest took before; nothing is run."""

from __future__ import annotations

from pathlib import Path
from statistics import median

from kinema.experiments.config import compose
from kinema.experiments.jobs import TRAIN, Job
from kinema.experiments.replications import scored_lines
from kinema.experiments.stages import get_stage
from kinema.experiments.tables import TableRow
from kinema.runs.console import console
from kinema.runs.folder import RunFolder


def print_plan(jobs: list[Job], rows: list[TableRow]) -> None:
    """Print the runs and rows of a table: cached ones counted, missing ones with their commands and times."""
    runs = {path for row in rows if row.place is not None for path in row.place.runs.values()}
    places = {row.place.folder.path: row for row in rows if row.place is not None}
    done = sum(row.complete for row in places.values())
    console.print(
        f"cached    {sum(RunFolder(path).done for path in runs)} of {len(runs)} runs, {done} of {len(places)} rows"
    )
    times = [estimate(job) for job in jobs]
    for job, time in zip(jobs, times, strict=True):
        console.print(f"[bold]would run[/] {'unknown' if time is None else f'{time:.0f} s':>8}  {job}")
    known = [time for time in times if time is not None]
    unknown = (
        f", and {len(times) - len(known)} jobs of which none like it was run before" if len(known) < len(times) else ""
    )
    console.print(f"seconds   about {sum(known):.0f}, one job after the other{unknown}")


def estimate(job: Job) -> float | None:
    """Return the seconds that a job like this took before: of its own kind and size, else by its number of steps."""
    alike = [path for path in job.makes.parent.glob("*") if _kind(path) == _kind(job.makes)]
    if job.command != TRAIN:
        seconds = [line["seconds"] for path in alike for line in scored_lines(path)]
        return median(seconds) * len(job.replications) if seconds else None
    finished = [RunFolder(path).status.get("seconds") for path in alike if RunFolder(path).done]
    if known := [seconds for seconds in finished if seconds is not None]:  # an imported run took none
        return median(known)
    return _by_steps(job)


def _by_steps(job: Job) -> float | None:
    """Scale the seconds of runs of the same method at another size by the number of steps."""
    cfg = compose(list(job.overrides), job.command)
    stage = get_stage(cfg.stage)
    train = stage.config(cfg).get("train")
    steps = None if train is None else train.get("steps")
    others = job.makes.parent.glob(f"{stage.label(cfg)}-*")
    known = [status for path in others if (status := RunFolder(path).status).get("step")]
    return median(s["seconds"] / s["step"] for s in known) * steps if steps and known else None


def _kind(path: Path) -> str:
    """Return a folder's name without its seed and fingerprint."""
    return path.name.rsplit("-", 2)[0]

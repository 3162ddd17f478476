"""Run what a table or page lacks where its request says: in processes of this machine, or by a launcher."""

from __future__ import annotations

from collections.abc import Callable

from omegaconf import DictConfig

from kinema.experiments.config import refuse_absent_slurm
from kinema.experiments.jobs import Job, missing_jobs, processes, run_jobs
from kinema.experiments.multirun import run_multiruns
from kinema.experiments.request import Request
from kinema.experiments.tables import TableRow


def run_missing(rows: list[TableRow], own: list[str], request: Request) -> None:
    """Run what rows lack under the request's overrides and the table's own."""
    some = next(row.cfg for row in rows if row.cfg is not None)
    launch(lambda shared: missing_jobs(rows, shared, request.replications), [*request.shared, *own], request, some)


def launch(lacking: Callable[[list[str]], list[Job]], shared: list[str], request: Request, cfg: DictConfig) -> None:
    """Run the jobs that `lacking` makes of the overrides that each has to be given; multiruns give `shared` to all."""
    if request.launcher:
        refuse_absent_slurm(request.launcher)
        run_multiruns(lacking([]), [*shared, *request.launcher])
    else:
        run_jobs(lacking(shared), request.jobs or processes(cfg))

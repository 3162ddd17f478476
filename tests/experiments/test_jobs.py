"""A table's jobs make every run that it lacks, once, and each after what it reads."""

from __future__ import annotations

import pytest

from kinema.experiments.config import CONF
from kinema.experiments.jobs import EVALUATE, Job, missing_jobs, run_jobs
from kinema.experiments.tables import load_table, plan


@pytest.mark.parametrize("name", sorted(file.stem for file in (CONF / "table").glob("*.yaml")))
def test_every_row_has_its_job_and_every_run_is_made_once(name, micro_tables, tmp_path):
    table = load_table(name)
    overrides = [*(o for o in micro_tables if not o.startswith("generator.model")), f"paths.runs={tmp_path}"]
    rows = plan(table, overrides)
    jobs = missing_jobs(rows, [*overrides, *table.get("overrides", [])])
    made = [job.makes for job in jobs]
    assert len(set(made)) == len(made)
    assert {row.place.folder.path for row in rows if row.place} <= set(made)
    assert {path for job in jobs for path in job.reads} <= set(made)
    wanted = {path for row in rows if row.place for path in row.place.runs.values()}
    assert wanted <= set(made)
    for job in jobs:
        if job.command == EVALUATE:
            assert job.reads == {path for row in rows if row.place and row.place.folder.path == job.makes
                                 for path in row.place.runs.values()}  # fmt: skip


def test_what_most_wait_for_comes_first(micro_tables, tmp_path):
    jobs = missing_jobs(plan(load_table("table5"), [*micro_tables, f"paths.runs={tmp_path}"]), micro_tables)
    position = {job.makes: i for i, job in enumerate(jobs)}
    assert all(position[path] < position[job.makes] for job in jobs for path in job.reads)


@pytest.mark.slow
def test_a_job_waits_for_what_it_reads_and_a_failure_stops_what_follows(tmp_path, monkeypatch):
    """Jobs that are refused at once: the first failure is told, and what reads its run never starts."""
    first = Job("train", ("stage=nothing",), tmp_path / "a")
    after = Job("train", ("stage=nothing",), tmp_path / "b", frozenset({tmp_path / "a"}))
    with pytest.raises(OSError, match=r"`kinema train stage=nothing` failed: stage='nothing' is unknown; allowed: "):
        run_jobs([after, first], 1)

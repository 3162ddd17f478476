"""A table's jobs make every run that it lacks, once, and each after what it reads."""

from __future__ import annotations

from dataclasses import replace

import pytest

from kinema.experiments import multirun
from kinema.experiments.config import CONF, compose
from kinema.experiments.jobs import EVALUATE, TRAIN, Job, JobsFailedError, missing_jobs, run_jobs
from kinema.experiments.run import stage_folder
from kinema.experiments.stages import get_stage
from kinema.experiments.table_files import load_table
from kinema.experiments.tables import plan
from kinema.runs.folder import RunFolder
from kinema.runs.lines import append_line

ANYWHERE = [file.stem for file in sorted((CONF / "table").glob("*.yaml")) if "only" not in load_table(file.stem)]
"""Tables that are not of one corpus alone."""


@pytest.mark.parametrize("name", ANYWHERE)
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


def test_a_line_without_a_judge_that_is_asked_for_leaves_the_job_unfinished(tmp_path):
    line = {"replication": 0, "metrics": {}, "breakdowns": {}, "provenance": {}, "seconds": 1.0}
    append_line(tmp_path / "replications.jsonl", {**line, "unread": ["contrastive"]})
    without = Job(EVALUATE, (), tmp_path, replications=(0,), judges=frozenset({"matching"}))
    whole = replace(without, judges=frozenset({"matching", "contrastive"}))
    assert without.unfinished() is None
    assert whole.unfinished() is not None
    append_line(tmp_path / "replications.jsonl", line)
    assert whole.unfinished() is None


@pytest.mark.parametrize("unread", [[], ["evaluator.unread=[]"]])
def test_a_job_knows_its_rows_judges(unread, micro_tables, tmp_path):
    table = {**load_table("table5"), "rows": [{"key": "real", "kind": "real", "label": "real", "source": "real"}]}
    own = [*micro_tables, f"paths.runs={tmp_path}", "evaluator=redundant", *unread]
    (job,) = (job for job in missing_jobs(plan(table, own), own) if job.command == EVALUATE)
    assert job.judges == ({"matching", "contrastive"} if unread else {"matching"})


@pytest.mark.slow
def test_a_failure_leaves_out_what_waits_for_it_and_nothing_else(tmp_path, monkeypatch):
    """Jobs that are refused at once: each failure is told, and what reads its run never starts."""
    first = Job("train", ("stage=nothing",), tmp_path / "a")
    after = Job("train", ("stage=nothing",), tmp_path / "b", frozenset({tmp_path / "a"}))
    last = Job("train", ("stage=nothing",), tmp_path / "c", frozenset({tmp_path / "b"}))
    other = Job("train", ("stage=none",), tmp_path / "d")
    with pytest.raises(
        JobsFailedError, match=r"`kinema train stage=nothing` failed: stage='nothing' is unknown"
    ) as caught:
        run_jobs([last, after, first, other], 1)
    assert set(caught.value.failed) == {first, other}
    assert set(caught.value.left_out) == {after, last}
    assert "2 more wait for what failed" in str(caught.value)
    reasons = caught.value.reasons()
    assert set(reasons) == {tmp_path / name for name in "abcd"}
    assert reasons[tmp_path / "c"] == reasons[tmp_path / "b"] == reasons[tmp_path / "a"]
    assert reasons[tmp_path / "d"].startswith("stage='none' is unknown")


@pytest.mark.slow
def test_what_another_process_works_on_comes_last(tmp_path):
    """Jobs that are refused at once: of two that are ready, the one whose folder is held waits."""
    held, free = (Job("train", ("stage=nothing",), tmp_path / name) for name in ("held", "free"))
    with RunFolder(held.makes).lock(), pytest.raises(JobsFailedError) as caught:
        run_jobs([held, free], 1)
    assert list(caught.value.failed) == [free, held]


def test_what_is_of_scoring_alone_is_not_told_to_what_trains(micro_tables, tmp_path, monkeypatch):
    scoring = ["keep_motions=true", "lock_feet=true", "precision=bfloat16", f"evaluators.t2m={tmp_path}"]
    scoring += ["replications=[0]"]
    table = {**load_table("table5"), "rows": [row for row in load_table("table5")["rows"] if row["key"] == "mardm_sit"]}
    shared = [*micro_tables, f"paths.runs={tmp_path}", "generator.sampling.guidance=2", *scoring]
    rows = plan(table, shared)
    jobs = missing_jobs(rows, shared)
    training = [job for job in jobs if job.command == TRAIN]
    assert {job.overrides[0] for job in training} >= {"stage=tokenizer", "stage=generator"}
    for job in training:
        assert not set(job.overrides) & set(scoring)
        compose(list(job.overrides), "train")
    (scored,) = (job for job in jobs if job.command == EVALUATE)
    assert set(scoring) <= set(scored.overrides)
    called = []
    monkeypatch.setattr(multirun, "_run", lambda words, _: called.append(words))
    monkeypatch.setattr(Job, "unfinished", lambda _: None)
    multirun.run_multiruns(missing_jobs(rows), shared)
    assert {words[0] for words in called} == {"train", "evaluate"}
    assert all(
        set(scoring) <= set(words) if words[0] == "evaluate" else not set(scoring) & set(words) for words in called
    )


@pytest.mark.parametrize(("more", "told"), [([], False), (["generator.train.select=fid"], True)])
def test_how_motion_is_sampled_is_told_to_what_trains_where_it_selects_weights(more, told, micro_tables, tmp_path):
    (spec,) = (row for row in load_table("table5")["rows"] if row["key"] == "mardm_sit")
    own = {**spec, "overrides": ["generator.sampling.guidance=2"]}
    shared = [*micro_tables, f"paths.runs={tmp_path}", *more]
    jobs = missing_jobs(plan({**load_table("table5"), "rows": [own]}, shared), shared)
    (job,) = (job for job in jobs if job.overrides[0] == "stage=generator")
    assert ("generator.sampling.guidance=2" in job.overrides) == told
    cfg = compose(list(job.overrides), "train")
    assert stage_folder(cfg, get_stage("generator")).path == job.makes

"""What the results of a table rest on is said once where all rows share it, else row by row."""

from __future__ import annotations

from kinema.experiments.provenance import Said, other_judges, provenance

COMMAND = "kinema reproduce table5"


def said(label: str, seed: int | None, *judges: str) -> Said:
    shared = dict.fromkeys(("corpus", "statistics", "words", "tokens", "protocol", "text_encoder", "sampling"))
    shared |= {"device": "cpu", "seed": seed or 0, "versions": {"torch": "2"}, "runs": {"matching": "judge-s0-abc"}}
    lines = [
        {"replication": i, "provenance": {**shared, "evaluators": {"matching": judge}}}
        for i, judge in enumerate(judges)
    ]
    return Said(label, label if seed is None else f"{label} (seed {seed})", lines)


def test_rows_of_a_judge_that_was_trained_anew_are_told_by_seed_and_replication():
    same = [said("A", None, "one", "one"), said("A", 1, "one", "one"), said("B", None, "one", "one")]
    assert provenance(same, COMMAND)["evaluators"] == {"matching": "judge-s0-abc, weights one"}
    assert other_judges(same) == []
    mixed = [
        *same,
        said("B", 1, "two", "two"),
        said("C", None, "one", "two"),
        said("D", None, "two"),
        said("D", 1, "two"),
    ]
    assert provenance(mixed, COMMAND)["evaluators"] == {
        "A; B; C, replication 0": {"matching": "judge-s0-abc, weights one"},
        "B (seed 1); C, replication 1; D": {"matching": "judge-s0-abc, weights two"},
    }
    (note,) = other_judges(mixed)
    assert "evaluators of different weights (judge-s0-abc:" in note

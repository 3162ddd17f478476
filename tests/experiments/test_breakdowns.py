"""A table's parts: without what training has of a test clip, and by fields; older lines lack some of them."""

from __future__ import annotations

import pytest

from kinema.data.leakage import CAPTION, FRAMES, TAKE
from kinema.experiments.breakdowns import FEWEST, Parts, breakdowns, footnotes


def line(whole: int, frames: int, takes: int, **fields) -> dict:
    """Make a replication of `whole` clips: `frames` of them share none, `takes` of them no take."""
    parts = {TAKE: {"unseen": metrics(takes), "seen": metrics(whole - takes)}}
    parts |= {FRAMES: {"none": metrics(frames), "under half": metrics(whole - frames)}}
    return {"metrics": metrics(whole), "breakdowns": fields | parts}


def metrics(n: int) -> dict[str, float]:
    return {"n": n, "r1": n / 10_000, "fid": 1.0, "jitter": 2.0}


SPEC = {"key": "mdm", "label": "MDM", "kind": "method"}


def test_the_parts_of_a_test_are_nested_and_stand_beside_the_whole():
    near, other = breakdowns([Parts(SPEC, [[line(2000, 1600, 600, style={"old": metrics(7)})] * 2])])
    shown = {row["label"]: [cell["n"] for cell in row["results"]] for row in near["rows"]}
    assert shown == {
        "MDM: official": [2000, 2000],
        "MDM: no shared frames": [1600, 1600],
        "MDM: no shared take": [600, 600],
    }
    assert near["columns"][-1]["key"] == "fid"
    # The halves of what is nested are not told again as fields.
    assert other["title"] == "By style"
    assert [column["key"] for column in other["columns"]] == ["n", "r1", "r3", "matching"]


def test_fid_is_shown_of_enough_clips_alone():
    (near,) = breakdowns([Parts(SPEC, [[line(2000, FEWEST, FEWEST - 1), line(2000, FEWEST + 1, FEWEST + 1)]])])
    assert ["fid" in row["results"][1] for row in near["rows"]] == [True, True, False]
    (near,) = breakdowns([Parts(SPEC, [[line(90, 80, 70)]])])
    assert "fid" not in [column["key"] for column in near["columns"]]


def test_where_nothing_is_shared_the_table_says_so_and_repeats_nothing():
    alone = {"metrics": metrics(9), "breakdowns": {TAKE: {"unseen": metrics(9)}, FRAMES: {"none": metrics(9)}}}
    assert breakdowns([Parts(SPEC, [[alone]])]) == []
    assert footnotes([Parts(SPEC, [[alone]])]) == ["No test clip is of a take that training has."]
    assert footnotes([Parts(SPEC, [[line(90, 80, 70)]])]) == []


@pytest.mark.parametrize("order", [1, -1])
def test_lines_from_before_a_field_was_known_are_passed_over(order):
    old = {"metrics": metrics(9), "breakdowns": {}}
    new = {"metrics": metrics(9), "breakdowns": {CAPTION: {"seen": metrics(9)}}}
    (found,) = breakdowns([Parts(SPEC, [[old, new][::order]])])
    assert found["title"] == "By caption seen in training"
    assert [row["results"] for row in found["rows"]] == [[metrics(9)]]
    assert footnotes([Parts(SPEC, [[old]])]) == []


def test_several_seeds_count_as_one_result_each():
    row = Parts(SPEC, [[line(2000, 1600, 600), line(2000, 1400, 600)], [line(2000, 1000, 600)] * 2])
    (near,) = breakdowns([row])
    assert [[cell["n"] for cell in row["results"]] for row in near["rows"]] == [[2000] * 2, [1500, 1000], [600] * 2]
    assert [row["seeds"] for row in near["rows"]] == [2] * 3
    (alone,) = breakdowns([Parts(row.spec, row.seeds[:1])])
    assert [row["seeds"] for row in alone["rows"]] == [None] * 3

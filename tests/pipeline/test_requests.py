"""A motion's seed is its prompt's and its take's: nothing else of a request changes it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from kinema.pipeline.requests import takes_of
from kinema.seeds import request_seeds
from kinema.text.manifest import Entry
from kinema.text.prompts import Prompt

WALK, BOW = Prompt("walk"), Prompt("bow", frames=40)


def seeds(prompts, text, **asked):
    return [take.seed for take in takes_of(prompts, **asked) if take.prompt.text == text]


def test_seeds_do_not_depend_on_what_else_is_asked_for():
    alone = seeds([WALK], "walk", count=3, seed=7)
    assert alone == request_seeds(7, 3)
    assert seeds([BOW, WALK, Prompt("jump", count=5)], "walk", count=3, seed=7) == alone
    assert seeds([WALK], "walk", count=2, seed=7) == alone[:2]
    own = [Prompt("walk", seed=7), BOW]
    assert seeds(own, "walk", count=3, seed=1) == alone


def test_what_would_be_the_same_motion_is_a_further_take():
    again = takes_of([WALK, BOW, WALK], seed=7)
    assert [take.seed for take in again] == [7, 7, request_seeds(7, 2)[1]]
    assert [take.take for take in again] == [1, 1, 2]
    assert [take.index for take in again] == [1, 2, 3]


def test_without_a_seed_each_prompt_draws_its_own():
    first, second = takes_of([WALK, BOW])
    assert first.seed != second.seed


@pytest.mark.parametrize(("prompt", "frames"), [(WALK, 60), (BOW, 40), (Prompt("x", seconds=2.5), 50)])
def test_a_prompt_says_its_length_or_takes_the_usual_one(prompt, frames):
    (take,) = takes_of([prompt])
    assert take.frames(60, 20.0) == frames


def test_each_line_of_a_manifest_is_a_motion_of_its_own():
    entry = Entry("a.npz", "walk", 7, 40, "asked", 20.0, 1, None, "humanml3d", "r", "0", "M", {}, False, 1, "cpu", {})
    lines = [Prompt("walk", 40, seed=7, entry=replace(entry, file=file)) for file in ("a.npz", "a.html")]
    assert [take.seed for take in takes_of([*lines, Prompt("walk", 40, seed=7)])] == [7, 7, 7]

"""Files of many motions are named as a template says, below the folder that it names, and no two alike."""

from __future__ import annotations

from pathlib import Path

import pytest

from kinema.pipeline.naming import folder_of, name_files, slug
from kinema.pipeline.requests import takes_of
from kinema.text.prompts import Prompt

ASKED = takes_of([Prompt("A person walks.", seed=7, name="w"), Prompt("a man bows", count=2, seed=8)])


@pytest.mark.parametrize(
    ("text", "short"),
    [
        ("A person walks, slowly...", "a-person-walks-slowly"),
        ("../../etc/passwd", "etc-passwd"),
        ("C:\\x", "c-x"),
        ("Une élève démarre", "une-élève-démarre"),
        ("!?", "motion"),
        ("a person walks forward and then turns around to the left", "a-person-walks-forward-and-then-turns"),
        ("x" * 100, "x" * 40),
    ],
)
def test_a_text_becomes_a_part_of_a_name(text, short):
    assert slug(text) == short


def test_a_template_names_every_motion():
    names = name_files("made/{index:03d}-{slug}/{take}.npz", ASKED)
    assert names == [
        Path("made/001-a-person-walks/1.npz"),
        Path("made/002-a-man-bows/1.npz"),
        Path("made/003-a-man-bows/2.npz"),
    ]
    assert name_files("{{{seed}}}-{name:_>3}.npz", ASKED[:1]) == [Path("{7}-__w.npz")]


@pytest.mark.parametrize(
    ("out", "folder"),
    [
        ("made/{index}.npz", "made"),
        ("made/a-{index}/{slug}.npz", "made"),
        ("{index}.npz", "."),
        ("/made/{slug}/x/{index}.npz", "/made"),
        ("../{index}.npz", ".."),
    ],
)
def test_the_folder_is_what_stands_before_the_first_field(out, folder):
    assert folder_of(out) == Path(folder)
    assert all(file.is_relative_to(folder) for file in name_files(out, ASKED))


@pytest.mark.parametrize(
    ("out", "says"),
    [
        ("{text}.npz", r"{text} is nothing .* it may hold {index}, {slug}, {seed}, {take}, {name}"),
        ("{}.npz", r"{} is nothing"),
        ("{0}.npz", r"\{0} is nothing"),
        ("{slug.__class__}.npz", r"{slug.__class__} is nothing"),
        ("{seed!r}.npz", r"{seed!r} is nothing"),
        ("{index:{seed}}.npz", r"{index:{seed}} is nothing"),
        ("{index.npz", "expected '}'"),
        ("a}.npz", "Single '}'"),
        ("{slug:03d}.npz", r"{slug:03d} cannot be written"),
        ("{index:/>9}.npz", "writes the name of another folder"),
        (
            "{slug}.npz",
            "calls two motions a-man-bows.npz: 'a man bows' and .* .numbers 2 and 3.; add {index}",
        ),
        ("{name}{index}.npz", "the prompt 'a man bows' has no name"),
    ],
)
def test_what_names_no_motion_is_refused(out, says):
    with pytest.raises(ValueError, match=says):
        name_files(out, ASKED)


def test_names_that_differ_by_case_alone_are_one_on_some_systems():
    asked = takes_of([Prompt("a", name="W"), Prompt("b", name="w")])
    with pytest.raises(ValueError, match="calls two motions"):
        name_files("{name}.npz", asked)


@pytest.mark.parametrize("name", ["..", "."])
def test_a_name_leads_to_no_other_folder(name):
    with pytest.raises(ValueError, match="leads to another folder"):
        name_files("out/{name}/{index}.npz", takes_of([Prompt("walk", name=name)]))

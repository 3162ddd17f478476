from __future__ import annotations

import pytest

from kinema.data.captions import AnnotatedCaption, parse_captions, parse_line, swap_sides
from kinema.types import Caption


def test_line_with_tokens_and_times():
    found = parse_line("a man walks.#a/DET man/NOUN walk/VERB#1.5#4\n")
    assert found == AnnotatedCaption(Caption("a man walks.", ("a/DET", "man/NOUN", "walk/VERB")), 1.5, 4.0)
    assert found.tagged


@pytest.mark.parametrize("line", ["he runs", "he runs#he/PRON run/VERB", "he runs##0.0#0.0", "he runs##nan#nan"])
def test_lines_about_the_whole_clip(line):
    found = parse_line(line)
    assert found.caption.text == "he runs"
    assert not found.tagged


def test_a_tag_with_one_zero_is_a_part():
    assert parse_line("he runs##0.0#2.0").tagged


def test_hash_inside_a_caption_stays():
    assert parse_line("pose #2#pose/NOUN#0.0#0.0").caption.text == "pose #2"


@pytest.mark.parametrize(
    "line",
    [
        "a person does set #3 of jumps",
        "a person walks #fast",
        "a person walks#fast",
        "pose #2",
        "#1 in line walks",
        "set #3 of #4",
        "jumps #1 and #2 and #3 of them",
        "a #b #c #d e #f",
        "reads c# code",
    ],
)
def test_a_hash_in_a_bare_caption_is_text(line):
    assert parse_line(line) == AnnotatedCaption(Caption(line))
    assert parse_line(f"{line}##0.0#0.0") == AnnotatedCaption(Caption(line))


@pytest.mark.parametrize("tokens", ["a person walk", "a/DET person walk/VERB", "walk", "walk/VERB jump"])
@pytest.mark.parametrize("times", ["0.0#0.0", "1.5#4", "nan#nan"])
def test_tokens_of_which_one_has_no_tag_are_left_out(tokens, times):
    found = parse_line(f"a person walks#{tokens}#{times}")
    assert found.caption == Caption("a person walks")
    assert found.tagged == (times == "1.5#4")


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("#a/DET#0#0", "no caption"),
        ("##0#0", "no caption"),
        ("#", "no caption"),
        (" #walk/VERB", "no caption"),
        ("sets #1 #2 #3", "may end in text or in times"),
        ("a man walks # a man walk # 0.0 # 0.0", "may end in text or in times"),
        ("he runs#1.0#2.0", "three fields"),
        ("pose #2#pose/NOUN", "three fields"),
        ("he runs#run/VERB#x#4", "'x'"),
        ("he runs#he/PRON#1.0", "three fields"),
        ("he runs##soon#2.0", "'soon'"),
        ("he runs##-1#2.0", "not negative"),
        ("he runs##0#inf", "finite"),
    ],
)
def test_unreadable_lines_say_why(line, says):
    with pytest.raises(ValueError, match=says):
        parse_line(line)


def test_blank_lines_are_passed_over():
    assert [c.caption.text for c in parse_captions("\none\n\n  \ntwo\n")] == ["one", "two"]


@pytest.mark.parametrize(
    ("text", "mirrored"),
    [
        ("turns left, then right", "turns right, then left"),
        ("Left hand over RIGHT hand", "Right hand over LEFT hand"),
        ("walks clockwise", "walks counterclockwise"),
        ("walks counterclockwise then clockwise", "walks clockwise then counterclockwise"),
        ("anticlockwise, anti-clockwise, counter clockwise", "clockwise, clockwise, clockwise"),
        ("a left-handed throw, left-hand side, leftwards", "a right-handed throw, right-hand side, rightwards"),
        ("bright lights, cleft, upright", "bright lights, cleft, upright"),
        ("turn/VERB counter/NOUN clockwise/NOUN left/ADV", "turn/VERB clockwise/NOUN right/ADV"),
    ],
)
def test_sides_swap_as_whole_words_at_once(text, mirrored):
    assert swap_sides(text) == mirrored


def test_swapping_twice_gives_the_text_back():
    text = "left foot, right arm, clockwise, counterclockwise, left-handed, rightmost"
    assert swap_sides(swap_sides(text)) == text


def test_mirroring_swaps_tokens_and_keeps_times():
    found = parse_line("turn left#turn/VERB left/ADV#1.0#3.0").mirrored()
    assert found == AnnotatedCaption(Caption("turn right", ("turn/VERB", "right/ADV")), 1.0, 3.0)

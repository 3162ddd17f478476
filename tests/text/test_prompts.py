"""A file of prompts gives the prompts that stand in it, whatever wrote it; what is no prompt is named by its line."""

from __future__ import annotations

import codecs

import pytest

from kinema.text.prompts import Prompt, is_file_name, parse_prompt, read_prompts


@pytest.mark.parametrize(
    ("line", "prompt"),
    [
        ("a person walks", Prompt("a person walks")),
        ("  a person walks \t", Prompt("a person walks")),
        ("a person walks.#120", Prompt("a person walks.", 120)),
        ("a person walks#NA", Prompt("a person walks")),
        ("a person walks#na ", Prompt("a person walks")),
        ("a person walks#0", Prompt("a person walks", 0)),
        ("a person strikes pose #2", Prompt("a person strikes pose #2")),
        ("a person strikes pose #2#60", Prompt("a person strikes pose #2", 60)),
        ("a person walks #fast", Prompt("a person walks #fast")),
        ("a person walks#fast", Prompt("a person walks#fast")),
        ("a man walks.#a/DET man/NOUN walk/VERB#0.0#0.0", Prompt("a man walks.")),
        ("a man walks##0.0#nan", Prompt("a man walks")),
        ("a man walks##1.5#4", Prompt("a man walks")),
        ("une personne démarre#80", Prompt("une personne démarre", 80)),
    ],
)
def test_a_line_is_a_prompt_and_its_length(line, prompt):
    assert parse_prompt(line) == prompt


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize(
    ("mark", "encoding"),
    [
        (b"", "utf-8"),
        (codecs.BOM_UTF8, "utf-8"),
        (codecs.BOM_UTF16_LE, "utf-16-le"),
        (codecs.BOM_UTF16_BE, "utf-16-be"),
    ],
)
def test_blank_lines_encodings_that_say_so_and_ends_of_lines_do_not_matter(tmp_path, mark, encoding, end):
    file = tmp_path / "prompts.txt"
    file.write_bytes(mark + end.join(["", "a person walks#40", "  ", "elle démarre", ""]).encode(encoding))
    assert read_prompts(file) == [Prompt("a person walks", 40), Prompt("elle démarre")]


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "holds no prompt"),
        (b"\n \n", "holds no prompt"),
        (b"a man walks\n#120\n", "line 2: '#120' has no text"),
        (b"a man walks\n##0#0\n", "line 2: .* has no text"),
        ("a man walks\nelle démarre\n".encode("cp1252"), "line 2: byte 0xe9 in column 7 is not UTF-8"),
        ("a man\n".encode("utf-16-le"), "line 1: it holds zero bytes"),
        ("a man\n".encode("utf-32"), "line 1: it holds zero bytes"),
        (codecs.BOM_UTF16_LE + b"abc", "line 1: the file begins as UTF-16-LE"),
        (b"a\0b", "line 1: it holds zero bytes"),
    ],
)
def test_what_is_no_prompt_is_named(tmp_path, content, says):
    file = tmp_path / "prompts.txt"
    file.write_bytes(content)
    with pytest.raises(ValueError, match=says):
        read_prompts(file)
    with pytest.raises(FileNotFoundError, match="is a folder, not a file; give a text file"):
        read_prompts(tmp_path)


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("prompts.txt", True),
        ("some/where/texts.json", True),
        ("there", True),
        ("a person walks", False),
        ("walks.", False),
        ("walk", False),
        ("a person reads prompts.txt", False),
        ("x" * 5000, False),
    ],
)
def test_a_file_is_not_taken_for_a_prompt(tmp_path, monkeypatch, text, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there").write_text("a person walks")
    assert is_file_name(text) is name

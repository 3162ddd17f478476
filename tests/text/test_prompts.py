"""A file of prompts gives the prompts that stand in it, whatever wrote it; what is no prompt is named by its line."""

from __future__ import annotations

import codecs
import re

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


ROWS = [Prompt("a man walks, then runs", seconds=2.5, seed=3), Prompt("bow", frames=40, count=2, name="bow_1")]


def test_tables_and_objects_say_the_same(tmp_path):
    table, objects = tmp_path / "p.CSV", tmp_path / "p.jsonl"
    table.write_text('text, frames,seconds,count,seed,name\n"a man walks, then runs",,2.5,,3,\n\nbow,40,,2,,bow_1\n')
    objects.write_text(
        '{"text": "a man walks, then runs", "seconds": 2.5, "seed": 3, "name": null}\n\n'
        '{"text": " bow", "frames": 40, "count": 2, "name": "bow_1"}\n'
    )
    assert read_prompts(table) == read_prompts(objects) == ROWS


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("a.csv", "", "holds no prompt; write a line of column names"),
        ("a.csv", "text\n", "holds no prompt; write a line of column names"),
        (
            "a.csv",
            "text,frame\nwalk,40",
            "line 1: 'frame' is nothing that a prompt has; it has text, frames, ",
        ),
        ("a.csv", "frames\n40\n", "line 1: there is no text"),
        ("a.csv", "text,text\na,b\n", "line 1: 'text' stands there twice"),
        ("a.csv", "text,seed\nwalk,1\n ,2\n", "line 3: its text is empty"),
        ("a.csv", "text,frames\nwalk,40.5\n", "line 2: frames=40.5: must be a whole number from 1"),
        ("a.csv", "text,frames\nwalk,many\n", "line 2: frames=many: must be a whole number"),
        ("a.csv", "text,seconds\nwalk,nan\n", "line 2: seconds=NaN: must be a finite number"),
        ("a.csv", "text,seconds\nwalk,-1\n", "line 2: seconds=-1: must be a finite number > 0"),
        ("a.csv", "text,count\nwalk,0\n", "line 2: count=0: must be a whole number from 1"),
        ("a.csv", "text,seed\nwalk,-1\n", "line 2: seed=-1: must be a whole number"),
        ("a.csv", "text,name\nwalk,../a\n", 'line 2: name="../a": must be 60 letters, digits'),
        ("a.csv", "text,frames,seconds\nwalk,40,2\n", "line 2: frames=40 and seconds=2; give one"),
        ("a.csv", "text,seed\nwalk, then run,1\n", "line 2: 3 cells for 2 columns; put a text with a comma between"),
        ("a.csv", 'text\n"walk"s\n', "line 2: "),
        ("a.jsonl", "{}\n", "line 1: there is no text"),
        ("a.jsonl", '{"text": "walk"}\n{"text": "run"\n', "line 2 is no JSON"),
        ("a.jsonl", '["walk"]\n', "line 1 is no object; write an object a line"),
        ("a.jsonl", '{"text": ["walk"]}\n', "line 1: text=.*: must be text"),
        ("a.jsonl", '{"text": "walk", "count": true}\n', "line 1: count=true: must be a whole number"),
        ("a.jsonl", '{"text": "walk", "seed": "1"}\n', 'line 1: seed="1": must be a whole number'),
        ("a.jsonl", '{"text": "walk", "speed": 1}\n', "line 1: 'speed' is nothing that a prompt has"),
        ("a.json", '[{"text": "walk"}]', "prompts are read from .txt .* not .json"),
    ],
)
def test_what_is_wrong_with_a_row_is_named_with_its_line(tmp_path, name, content, says):
    file = tmp_path / name
    file.write_text(content)
    with pytest.raises(ValueError, match=re.escape(str(file)) + ".*" + says):
        read_prompts(file)

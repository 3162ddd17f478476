"""Read files of prompts: lines of text, or rows (.csv, .jsonl) of text, length, count, seed and name."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

from kinema.files.lines import Line, read_lines
from kinema.options import Count, Matches, Positive, Seed, check_value
from kinema.text.manifest import Entry, read_entry

_LENGTH = re.compile(r"(?P<text>.*\S)#(?P<frames>\d{1,9}|NA)\s*$", re.IGNORECASE)
_CAPTION = re.compile(r"(?P<text>[^#]*\S)#[^#]*#(?:[\d.]+|nan)#(?:[\d.]+|nan)\s*$", re.IGNORECASE)

Name = Annotated[str, Matches(r"\w[\w.-]{0,59}", "60 letters, digits, `_`, `-`, `.` at most, a letter or digit first")]


@dataclass(frozen=True)
class Prompt:
    """Hold what motions are made of: a text, and what was said of them (None: not said).

    `frames` or `seconds` is their length, `count` how many are made, `seed` that of the first, `name` stands in files'
    names, `entry` is the line of a manifest that it was read from, `where` says in which line of a file it stands.
    """

    text: str
    frames: int | None = None
    seconds: float | None = None
    count: int | None = None
    seed: int | None = None
    name: str | None = None
    entry: Entry | None = None
    where: str | None = field(default=None, compare=False)


RULES: dict[str, Any] = {"text": str, "frames": Count, "seconds": Positive, "count": Count, "seed": Seed, "name": Name}
"""What columns and keys may hold; those that are empty, null or left out are not said."""
COLUMNS = ", ".join(RULES)


def parse_prompt(line: str) -> Prompt:
    """Read `text`, `text#FRAMES`, `text#NA` (no length) or a corpus' `caption#tokens#start#end`, of which the caption.

    A `#` behind a space or before words belongs to the text, as in "pose #2".
    """
    line = line.strip()
    if caption := _CAPTION.match(line):
        return Prompt(caption["text"].strip())
    if found := _LENGTH.match(line):
        return Prompt(found["text"].strip(), int(found["frames"]) if found["frames"].isdecimal() else None)
    return Prompt(line)


def read_prompts(file: str | Path) -> list[Prompt]:
    """Read a file of prompts by its suffix: .csv, .jsonl, else lines (`parse_prompt`); blank lines are passed over.

    Raises FileNotFoundError, or ValueError that names a line, what is wrong and what is allowed.
    """
    path = Path(file)
    if path.suffix.lower() in (".json", ".tsv", ".xlsx", ".yaml"):
        raise ValueError(f"{path}: prompts are read from .txt (one a line), .csv and .jsonl, not {path.suffix}")
    read = READERS.get(path.suffix.lower(), _from_text)
    prompts = list(read(path, read_lines(path)))
    if not prompts:
        raise ValueError(f"{path} holds no prompt; {EMPTY.get(path.suffix.lower(), ONE)}")
    return prompts


def _from_text(path: Path, lines: list[Line]) -> Iterator[Prompt]:
    for line in lines:
        if line.text.strip():
            if line.text.lstrip().startswith("#"):
                raise ValueError(f"{path}, line {line.number}: {line.text.strip()!r} has no text before its `#`")
            yield replace(parse_prompt(line.text), where=f"{path}, line {line.number}")


def _from_csv(path: Path, lines: list[Line]) -> Iterator[Prompt]:
    """Read rows below a line of column names; a text may go over several lines between quotes."""
    reader = csv.reader(io.StringIO("\n".join(line.text for line in lines)), strict=True)
    columns: list[str] | None = None
    try:
        for cells in reader:
            where = f"{path}, line {reader.line_num}"
            if not any(cell.strip() for cell in cells):
                continue
            if columns is None:
                columns = _known([cell.strip() for cell in cells], where)
                continue
            if len(cells) != len(columns):
                raise ValueError(
                    f"{where}: {len(cells)} cells for {len(columns)} columns; put a text with a comma between quotes"
                )
            row = dict(zip(columns, map(str.strip, cells), strict=True))
            yield _prompt({key: _number(value) if key in NUMBERS else value for key, value in row.items()}, where)
    except csv.Error as error:
        raise ValueError(f"{path}, line {reader.line_num}: {error}") from None


def _from_jsonl(path: Path, lines: list[Line]) -> Iterator[Prompt]:
    for line in lines:
        if not line.text.strip():
            continue
        where = f"{path}, line {line.number}"
        try:
            row = json.loads(line.text)
        except (ValueError, RecursionError) as error:
            raise ValueError(f"{where} is no JSON ({error}); {EMPTY['.jsonl']}") from None
        if not isinstance(row, dict):
            raise ValueError(f"{where} is no object; {EMPTY['.jsonl']}")
        if "file" in row:
            yield _again(read_entry(line.text, where), where)
            continue
        _known(list(row), where)
        yield _prompt(row, where)


def _again(entry: Entry, where: str) -> Prompt:
    """Return the prompt that gives a manifest's motion again; a length that was the model's own is left to it."""
    for key, value in {"frames": entry.frames, "seed": entry.seed, "name": entry.name}.items():
        if value is not None:
            check_value(value, RULES[key], f"{where}: {key}")
    frames = entry.frames if entry.length == "asked" else None
    return Prompt(entry.text, frames, seed=entry.seed, name=entry.name, entry=entry, where=where)


def _known(names: list[str], where: str) -> list[str]:
    """Refuse names that prompts don't have."""
    for name in names:
        if name not in RULES:
            raise ValueError(f"{where}: {name!r} is nothing that a prompt has; it has {COLUMNS}")
        if names.count(name) > 1:
            raise ValueError(f"{where}: {name!r} stands there twice")
    if "text" not in names:
        raise ValueError(f"{where}: there is no text; a prompt has {COLUMNS}")
    return names


def _prompt(row: dict[str, Any], where: str) -> Prompt:
    """Check one row."""
    said = {key: value for key, value in row.items() if value is not None and value != ""}
    if not str(said.get("text", "")).strip():
        raise ValueError(f"{where}: its text is empty; say what the person does")
    for key, value in said.items():
        check_value(value, RULES[key], f"{where}: {key}")
    if {"frames", "seconds"} <= set(said):
        raise ValueError(f"{where}: frames={said['frames']} and seconds={said['seconds']}; give one of them")
    return Prompt(**{**said, "text": said["text"].strip()}, where=where)


def _number(cell: str) -> Any:
    """Return a cell's number; what is none stays text, which the rules refuse."""
    for kind in (int, float):
        try:
            return kind(cell)
        except ValueError:
            continue
    return cell


NUMBERS = ("frames", "seconds", "count", "seed")
READERS: dict[str, Callable[[Path, list[Line]], Iterator[Prompt]]] = {".csv": _from_csv, ".jsonl": _from_jsonl}
ONE = "write one a line, e.g. `a person walks` or `a person walks#120`"
EMPTY = {
    ".csv": f"write a line of column names (of {COLUMNS}) and a row a prompt",
    ".jsonl": 'write an object a line, e.g. {"text": "a person walks", "seconds": 4, "seed": 1}',
}


def is_file_name(text: str) -> bool:
    """Tell whether a prompt is rather the name of a file: one that is there, or a single word that ends like one."""
    try:
        there = Path(text).is_file()
    except (OSError, ValueError):  # too long for a name, or with a zero byte
        there = False
    return there or re.fullmatch(r"\S+\.(?:txt|csv|json|jsonl|tsv|md)", text.strip()) is not None

"""Read files of prompts: one a line, with the motion's length behind a `#` where it has one."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from kinema.files.lines import read_lines

_LENGTH = re.compile(r"(?P<text>.*\S)#(?P<frames>\d{1,9}|NA)\s*$", re.IGNORECASE)
_CAPTION = re.compile(r"(?P<text>[^#]*\S)#[^#]*#(?:[\d.]+|nan)#(?:[\d.]+|nan)\s*$", re.IGNORECASE)


@dataclass(frozen=True)
class Prompt:
    """Hold what a motion is made of: a text, and its frames (None: not said)."""

    text: str
    frames: int | None = None


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
    """Read a file of prompts, blank lines passed over. Raises FileNotFoundError, or ValueError that names a line."""
    path, prompts = Path(file), []
    for line in read_lines(path):
        if line.text.strip():
            if line.text.lstrip().startswith("#"):
                raise ValueError(f"{path}, line {line.number}: {line.text.strip()!r} has no text before its `#`")
            prompts.append(parse_prompt(line.text))
    if not prompts:
        raise ValueError(f"{path} holds no prompt; write one a line, e.g. `a person walks` or `a person walks#120`")
    return prompts


def is_file_name(text: str) -> bool:
    """Tell whether a prompt is rather the name of a file: one that is there, or a single word that ends like one."""
    try:
        there = Path(text).is_file()
    except (OSError, ValueError):  # too long for a name, or with a zero byte
        there = False
    return there or re.fullmatch(r"\S+\.(?:txt|csv|json|jsonl|tsv|md)", text.strip()) is not None

"""Name the files of many motions by one template: `motions/{index:03d}-{slug}-{seed}.bvh`."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Sequence
from pathlib import Path
from string import Formatter

from kinema.pipeline.requests import Take

LONGEST = 40
"""Letters of a slug."""

FIELDS: dict[str, Callable[[Take], int | str]] = {
    "index": lambda take: take.index,
    "slug": lambda take: slug(take.prompt.text),
    "seed": lambda take: take.seed,
    "take": lambda take: take.take,
    "name": lambda take: take.prompt.name or "",
}
"""What a template may hold: the motion's number, its text, its seed, its number among those of its prompt, its name."""

Piece = tuple[str, str | None, str]
"""Letters, the field behind them (None: none) and how it is written."""


def is_template(out: str) -> bool:
    """Tell whether names hold fields."""
    return "{" in out or "}" in out


def name_files(out: str, asked: Sequence[Take]) -> list[Path]:
    """Name a file for each motion.

    Raises ValueError for an unknown field (naming those there are), and for two motions of one name.
    """
    pieces = _pieces(out)
    found: dict[str, Take] = {}
    files = []
    for take in asked:
        file = "".join(before + _written(field, spec, take, out) for before, field, spec in pieces)
        if {".", ".."} & set(file.removeprefix(pieces[0][0]).split("/")):
            raise ValueError(f"--out {out} would call a motion {file}, which leads to another folder")
        other = found.setdefault(file.casefold(), take)  # some file systems take both cases for one
        if other is not take:
            raise ValueError(
                f"--out {out} calls two motions {file}: {other.prompt.text!r} and {take.prompt.text!r} "
                f"(numbers {other.index} and {take.index}); add {{index}} to it, which is never the same"
            )
        files.append(Path(file))
    return files


def folder_of(out: str) -> Path:
    """Return the folder that a template names before its first field: all files are below it."""
    before = ""
    for letters, field, _ in _pieces(out):
        before += letters
        if field is not None:
            break
    return Path(before.rpartition("/")[0] or ("/" if before.startswith("/") else "."))


def slug(text: str) -> str:
    """Write a text as a part of a file's name: its first words in small letters, joined by `-`."""
    words = re.findall(r"\w+", unicodedata.normalize("NFKC", text).casefold().replace("_", " "))
    short = ""
    for word in words:
        if short and len(short) + 1 + len(word) > LONGEST:
            break
        short = f"{short}-{word}"[:LONGEST] if short else word[:LONGEST]
    return short or "motion"


def _pieces(out: str) -> list[Piece]:
    allowed = ", ".join(f"{{{name}}}" for name in FIELDS)
    try:
        parsed = list(Formatter().parse(out))
    except ValueError as error:
        raise ValueError(f"--out {out}: {error}; it may hold {allowed}, and {{{{ for a brace") from None
    for _, field, spec, conversion in parsed:
        if field is not None and (field not in FIELDS or conversion or "{" in (spec or "")):
            told = field + (f"!{conversion}" if conversion else "") + (f":{spec}" if spec else "")
            raise ValueError(f"--out {out}: {{{told}}} is nothing that a motion has; it may hold {allowed}")
    return [(letters, field, spec or "") for letters, field, spec, _ in parsed]


def _written(field: str | None, spec: str, take: Take, out: str) -> str:
    if field is None:
        return ""
    value = FIELDS[field](take)
    if value == "":
        raise ValueError(f"--out {out}: the prompt {take.prompt.text!r} has no name; give it one (a column `name`)")
    try:
        text = format(value, spec)
    except ValueError as error:
        raise ValueError(f"--out {out}: {{{field}:{spec}}} cannot be written ({error}); try {{index:03d}}") from None
    if re.search(r"[/\\\0]", text):
        raise ValueError(f"--out {out}: {{{field}:{spec}}} writes the name of another folder")
    return text

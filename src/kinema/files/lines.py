"""Read text files that people write: UTF-8, or UTF-16 that says so; what is neither is named by its line."""

from __future__ import annotations

import codecs
import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from kinema.files.kinds import DamagedError, require_file

MARKS = ((codecs.BOM_UTF8, "utf-8"), (codecs.BOM_UTF16_LE, "utf-16-le"), (codecs.BOM_UTF16_BE, "utf-16-be"))
FIX = "save the file as UTF-8 (iconv -f CP1252 -t UTF-8, or the encoding that it is in)"


@dataclass(frozen=True)
class Line:
    """Hold one line and its number, from 1; `problem` says why it cannot be read, and its text is then empty."""

    number: int
    text: str
    problem: str = ""


def scan_lines(file: Path) -> list[Line]:
    """Read every line of a text file; those that are not in its encoding come with a problem, never guessed at."""
    content, encoding = file.read_bytes(), "utf-8"
    for mark, name in MARKS:
        if content.startswith(mark):
            content, encoding = content[len(mark) :], name
            break
    try:
        # Not str.splitlines: a JSON string may hold U+2028 and other separators that end no line of a file.
        found = io.StringIO(content.decode(encoding), newline=None)
        lines = [Line(i, text.removesuffix("\n")) for i, text in enumerate(found, start=1)]
    except UnicodeDecodeError:
        if encoding != "utf-8":
            return [Line(1, "", f"the file begins as {encoding.upper()} and goes on as something else; {FIX}")]
        lines = list(_decoded(content))
    zeros = f"it holds zero bytes (UTF-16 without its mark?); {FIX}"
    return [Line(line.number, "", zeros) if "\0" in line.text else line for line in lines]


def read_lines(file: Path) -> list[Line]:
    """Read every line of a text file. Raises FileNotFoundError, or DamagedError naming a line that is no text."""
    lines = scan_lines(require_file(file, "give a text file"))
    for line in lines:
        if line.problem:
            raise DamagedError(f"{file}, line {line.number}: {line.problem}")
    return lines


def _decoded(content: bytes) -> Iterator[Line]:
    for number, raw in enumerate(content.splitlines(), start=1):
        try:
            yield Line(number, raw.decode())
        except UnicodeDecodeError as error:
            wrong = f"byte 0x{raw[error.start]:02x} in column {error.start + 1} is not UTF-8"
            yield Line(number, "", f"{wrong}, after {raw[: error.start].decode()[-20:]!r}; {FIX}")

"""Read caption files, and say of what isn't as it should be which line it is, why, and how to mend it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from kinema.data.captions import AnnotatedCaption, parse_line, tokens_of, untagged
from kinema.data.folders import stems
from kinema.files.lines import scan_lines

LOST = "\ufffd"
"""What decoders write for what they could not read."""


@dataclass(frozen=True)
class Flaw:
    """Say what can be wrong with a line: its name, how grave it is, what such lines are, the fix, and where it was."""

    name: str
    severity: Literal["warning", "info"]
    message: str
    fix: str
    of: Literal["captions", "manifest"] = "captions"


UNREADABLE = Flaw("unreadable captions", "warning", "caption lines cannot be read", "write `caption#tokens#start#end`")
"""The only one for which a line is left out."""
UNTAGGED = Flaw(
    "untagged tokens",
    "warning",
    "captions have tokens without /POS, which are made anew of the caption",
    "write word/POS (walk/VERB), or no tokens: `caption##0#0`",
)
REPLACED = Flaw(
    "replaced characters",
    "warning",
    f"captions hold {LOST!r}, which stands for lost characters",
    "write them again from the original, in UTF-8",
)
REPEATED = Flaw(
    "repeated captions", "info", "captions stand twice in one file", "remove one, unless it shall weigh more"
)
EMPTY = Flaw("empty lines", "info", "lines between captions are empty", "remove them, or write the caption")
STRAY = Flaw(
    "names of no clip",
    "warning",
    "names in manifest.json are of no clip, and what it says of them has no effect",
    "spell them as the files in joints/, or take them out",
    "manifest",
)
READABLE = (UNTAGGED, REPLACED, REPEATED, EMPTY, STRAY)


@dataclass(frozen=True)
class Slip:
    """Hold what is wrong with a file, named from the corpus' folder on, and the line, if it is one's."""

    file: str
    line: int | None
    flaw: Flaw
    what: str

    def __str__(self) -> str:
        return f"{self.file}{'' if self.line is None else f', line {self.line}'}: {self.what}"


def read_captions(root: Path, file: str) -> tuple[list[AnnotatedCaption], list[Slip]]:
    """Read a caption file of a corpus in UTF-8, or UTF-16 that says so: the captions, and what is wrong by line."""
    captions: list[AnnotatedCaption] = []
    slips: list[Slip] = []
    lines = scan_lines(root / file)
    last = max((line.number for line in lines if line.text.strip()), default=0)
    for line in lines:
        try:
            if line.problem:
                raise ValueError(line.problem)
            if not line.text.strip():
                slips += [Slip(file, line.number, EMPTY, "it is empty")] if line.number < last else []
                continue
            found = parse_line(line.text)
        except ValueError as error:
            slips.append(Slip(file, line.number, UNREADABLE, str(error)))
            continue
        slips += [Slip(file, line.number, flaw, what) for flaw, what in _flaws(line.text, found, captions)]
        captions.append(found)
    return captions, slips


def find_slips(root: Path) -> list[Slip]:
    """Read all caption files of a corpus' folder, and say what is wrong with them."""
    folder = root / "texts"
    return [s for name in stems(folder, ".txt") for s in read_captions(root, f"texts/{name}.txt")[1]]


def check_readable(root: Path, slips: list[Slip], read: int) -> None:
    """Raise ValueError if more than half of the caption lines cannot be read: they are of another form or encoding."""
    lost = [slip for slip in slips if slip.flaw is UNREADABLE]
    if len(lost) > read:
        raise ValueError(
            f"{root}: {len(lost)} of {len(lost) + read} caption lines cannot be read (first, {lost[0]}); mend them, or "
            "remove texts/ to go without captions"
        )


def _flaws(line: str, caption: AnnotatedCaption, before: list[AnnotatedCaption]) -> Iterator[tuple[Flaw, str]]:
    """Find what doesn't keep a line from being read."""
    text, start = caption.caption.text, caption.start
    if bare := untagged(tokens_of(line)):
        yield UNTAGGED, f"token {bare!r} has no /POS"
    if LOST in line:
        yield REPLACED, repr(text)
    if any((other.caption.text, other.start) == (text, start) for other in before):
        yield REPEATED, repr(text)

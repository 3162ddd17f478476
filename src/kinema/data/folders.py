"""Walk the folders of a corpus: links to folders are followed, hidden files (macOS' `._NAME`) passed over."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from kinema.files.lines import read_lines


def walk(root: Path) -> Iterator[tuple[str, list[str]]]:
    """Give every folder below `root`, itself first, with the names of its files, sorted; a link upwards ends there."""
    return _walk(str(root), ()) if os.path.isdir(root) else iter(())


def _walk(folder: str, above: tuple[str, ...]) -> Iterator[tuple[str, list[str]]]:
    real = os.path.realpath(folder)
    if real in above:
        return
    entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
    yield folder, [entry.name for entry in entries if not entry.is_dir()]
    for entry in entries:
        if entry.is_dir():
            yield from _walk(entry.path, (*above, real))


def stems(root: Path, suffix: str) -> list[str]:
    """Name the files below a folder that have a suffix, by their path without it."""
    found = []
    for folder, files in walk(root):
        below = Path(folder).relative_to(root)
        if any(part.startswith(".") for part in below.parts):
            continue
        found += [(below / f).as_posix().removesuffix(suffix) for f in files if f.endswith(suffix) and f[0] != "."]
    return found


def listed_names(file: Path) -> list[str]:
    """Read a list of clips, one name a line; `NAME.npy` is read as `NAME`. Raises ValueError for what is no text."""
    lines = (line.text.strip() for line in read_lines(file))
    return [line.removesuffix(".npy") for line in lines if line]

"""Walk the folders of a corpus: links to folders are followed, hidden files (macOS' `._NAME`) passed over."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator
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


def visible_files(root: Path) -> list[str]:
    """Name the files below a folder by their path from there; hidden ones and those of hidden folders are none."""
    found = []
    for folder, files in walk(root):
        below = Path(folder).relative_to(root)
        if not any(part.startswith(".") for part in below.parts):
            found += [(below / file).as_posix() for file in files if not file.startswith(".")]
    return found


def stems(root: Path, suffix: str) -> list[str]:
    """Name the files below a folder that have a suffix, by their path without it."""
    return [file.removesuffix(suffix) for file in visible_files(root) if file.endswith(suffix)]


def instead_of(root: Path, folder: str, missing: Collection[str]) -> dict[str, str]:
    """Say of files that `root/folder` lacks which one lies there in their place, and the fix; by `folder/NAME.npy`."""
    alike = {file.lower(): f"{folder}/{file}" for file in (visible_files(root / folder) if missing else ())}
    found = {}
    for wanted in (f"{folder}/{file}" for file in missing):
        name = wanted.removeprefix(f"{folder}/").lower()
        archive = alike.get(f"{name.removesuffix('.npy')}.npz")
        if name in alike:
            found[wanted] = f"{alike[name]} is there: rename it"
        elif archive is not None:
            fix = f"kinema export {archive} --out {wanted}" if folder == "joints" else "save its array as .npy"
            found[wanted] = f"{archive} is there: {fix}"
    return found


def listed_names(file: Path) -> list[str]:
    """Read a list of clips, one name a line; `NAME.npy` is read as `NAME`. Raises ValueError for what is no text."""
    lines = (line.text.strip() for line in read_lines(file))
    return [line.removesuffix(".npy") for line in lines if line]

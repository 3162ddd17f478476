"""Keep what many files of motion are and how each is made again: one JSON object a line, `manifest.jsonl`."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, get_origin, get_type_hints

from kinema.atomic import write_text
from kinema.files.json import parse_json
from kinema.files.lines import read_lines
from kinema.locks import hold
from kinema.options import check_value

NAME = "manifest.jsonl"
Length = Literal["asked", "model"]
FIX = "take the line out, or move the file away"


@dataclass(frozen=True)
class Entry:
    """Hold one motion's line: what it is, and all that it takes to make it again.

    `file` is seen from the manifest's folder. `length` says whether `frames` were asked for or are the model's own.
    `model` is the fingerprint of the weights and of the text encoder, whatever folder they lie in; `sampling` holds
    every option of sampling, changed or not; `lock_feet` says whether feet that stand were held. `batch_size` counts
    motions that were generated together: the draws don't depend on it, the last bits of the numbers do.
    """

    file: str
    text: str
    seed: int
    frames: int
    length: Length
    fps: float
    take: int
    name: str | None
    skeleton: str
    run: str
    model: str
    method: str
    sampling: dict[str, Any]
    lock_feet: bool
    batch_size: int
    device: str
    versions: dict[str, str]


def _written(annotation: Any) -> Any:
    """Say what JSON has for an annotation."""
    if annotation is float:
        return int | float
    origin = get_origin(annotation)
    return str if origin is Literal else dict if origin is dict else annotation


KINDS = {name: _written(annotation) for name, annotation in get_type_hints(Entry).items()}


def read_entry(line: str, where: str) -> Entry:
    """Read one line; raises ValueError naming what is wrong."""
    row = parse_json(line, where, KINDS, fix=FIX)
    entry = Entry(**{key: row.get(key) for key in KINDS})
    check_value(entry.length, Length, f"{where}: length")
    return entry


def read_manifest(path: str | Path) -> list[Entry]:
    """Read all lines; raises FileNotFoundError, or ValueError that names the line."""
    path = Path(path)
    lines = [line for line in read_lines(path) if line.text.strip()]
    return [read_entry(line.text, f"{path}, line {line.number}") for line in lines]


def add(folder: Path, entries: Iterable[Entry]) -> Path:
    """Write lines into a folder's manifest, whole or not at all: a file's new line takes the place of its old one.

    Lines of other files stay as they are, those of deleted files too: they say how to make them again. Processes that
    write into one folder wait for each other.
    """
    path = folder / NAME
    with hold(folder / f".{NAME}.lock"):
        path.touch()  # NFS asks the server then: else it may still know that another machine's manifest wasn't there
        known = {entry.file: entry for entry in read_manifest(path)}
        known |= {entry.file: entry for entry in entries}
        text = "".join(json.dumps(asdict(entry), ensure_ascii=False) + "\n" for entry in known.values())
        return write_text(path, text)

"""Keep results as JSON lines, which a killed process can tear at the end only."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from kinema.atomic import needing_room
from kinema.files.json import Kind, parse_json
from kinema.runs.console import console


def append_line(path: Path, value: dict[str, Any]) -> None:
    """Append one JSON line, ending a torn last line first so that it can't swallow this one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with needing_room(path), open(path, "ab+") as file:
        torn = False
        if file.tell():  # its end as the opened file has it: asked for by name, NFS may tell an old size
            file.seek(-1, os.SEEK_END)
            torn = file.read(1) != b"\n"
        file.write((("\n" if torn else "") + json.dumps(value, sort_keys=True) + "\n").encode())
        file.flush()
        os.fsync(file.fileno())


def read_lines(path: Path, kind: Kind = dict) -> list[dict[str, Any]]:
    """Read JSON lines of a kind; a torn line (a killed process) is named and left out.

    Raises ValueError naming a line that no kill explains: not UTF-8, or JSON of another kind.
    """
    lines = []
    for number, text in enumerate(path.read_bytes().split(b"\n") if path.exists() else [], 1):
        if not text.strip():
            continue
        try:
            json.loads(text)
        except json.JSONDecodeError:
            told = f"{path!s}:{number} is not a whole line (a killed process?); left out"
            console.print(f"[yellow]warning[/]   {told}")
            continue
        except (ValueError, RecursionError):
            pass  # told below
        lines.append(parse_json(text, f"{path}:{number}", kind, fix="delete this line; what it held is made again"))
    return lines

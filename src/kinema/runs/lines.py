"""Keep results as JSON lines, which a killed process can tear at the end only."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from kinema.runs.console import console


def append_line(path: Path, value: dict[str, Any]) -> None:
    """Append one JSON line, ending a torn last line first so that it can't swallow this one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "ab+") as file:
        torn = False
        if file.tell():
            file.seek(-1, os.SEEK_END)
            torn = file.read(1) != b"\n"
        file.write((("\n" if torn else "") + json.dumps(value, sort_keys=True) + "\n").encode())
        file.flush()
        os.fsync(file.fileno())


def read_lines(path: Path) -> list[dict[str, Any]]:
    """Read JSON lines; a torn line (a killed process) is named and left out."""
    lines = []
    for number, text in enumerate(path.read_text(encoding="utf-8").splitlines() if path.exists() else [], 1):
        if not text.strip():
            continue
        try:
            lines.append(json.loads(text))
        except json.JSONDecodeError:
            console.print(f"[yellow]warning[/]   {path}:{number} is not a whole line (a killed process?); left out")
    return lines

"""Read text back, which is UTF-8."""

from __future__ import annotations

from pathlib import Path

from kinema.files.kinds import refuse, require_file, size

MOST = 256 << 20


def read_text(path: str | Path, *, most: int = MOST, fix: str = "save it as UTF-8") -> str:
    """Read a file of UTF-8; raises FileNotFoundError, or ValueError naming the file, its line and `fix`."""
    path = require_file(path, fix)
    if (found := path.stat().st_size) > most:
        raise refuse(path, f"has {size(found)}, allowed: {size(most)}", fix)
    content = path.read_bytes()
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line, byte = content.count(b"\n", 0, error.start) + 1, error.object[error.start]
        raise refuse(path, f"is not UTF-8 (line {line}, byte {byte:#04x})", fix) from None

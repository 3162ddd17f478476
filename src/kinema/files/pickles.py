"""Read pickles of plain containers, strings and numbers, and nothing that could run code."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

from kinema.files.kinds import describe, head_of, refuse, require_file

FIX = "fetch the original file, or save it anew from plain containers"


class _PlainUnpickler(pickle.Unpickler):
    """Refuse every global; lists, dicts, tuples, strings and numbers need none."""

    def find_class(self, module: str, name: str) -> Any:
        raise pickle.UnpicklingError(f"it names {module}.{name}, and pickles can run any code")


def load_plain(path: str | Path, kind: type, *, fix: str = FIX) -> Any:
    """Load a pickle of one kind (list, dict) that holds only lists, dicts, tuples, sets, strings and numbers.

    Raises FileNotFoundError, or ValueError that names the file and the offending global.
    """
    path = require_file(path, fix)
    head = head_of(path)
    if not head.startswith(b"\x80") and describe(head) != "is text":  # the oldest protocol is text
        raise refuse(path, f"{describe(head)}, no pickle", fix)
    try:
        with path.open("rb") as file:
            value = _PlainUnpickler(file).load()
    except Exception as error:  # what is cut off or changed can fail in any way: IndexError, struct.error, MemoryError
        raise refuse(path, f"is refused: {error or 'it is cut off'}", fix) from None
    if not isinstance(value, kind):
        raise refuse(path, f"holds a {type(value).__name__}, allowed: {kind.__name__}", fix)
    return value

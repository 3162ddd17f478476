"""Read pickles of plain containers, strings and numbers, and nothing that could run code."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any


class _PlainUnpickler(pickle.Unpickler):
    """Refuse every global; lists, dicts, tuples, strings and numbers need none."""

    def find_class(self, module: str, name: str) -> Any:
        raise pickle.UnpicklingError(f"it names {module}.{name}")


def load_plain(path: Path) -> Any:
    """Load a pickle that holds only lists, dicts, tuples, sets, strings and numbers.

    Raises ValueError that names the offending global.
    """
    with open(path, "rb") as file:
        try:
            return _PlainUnpickler(file).load()
        except (pickle.UnpicklingError, EOFError, ValueError, TypeError, LookupError, AttributeError) as error:
            raise ValueError(
                f"{path} is refused: {error or 'it is cut off'}. Only lists, dicts, strings and numbers are read from "
                f"pickles, since they can run any code; fetch the original file, or save it anew from plain containers"
            ) from None

"""Read tables of comma-separated values back."""

from __future__ import annotations

import csv
import io
from pathlib import Path

from kinema.files.kinds import refuse
from kinema.files.text import read_text

MOST = 256 << 20
"""Bytes that a table may have; HumanML3D's index has 1.5 million."""


def read_csv(path: str | Path, *needed: str, fix: str = "write it again") -> list[dict[str, str]]:
    """Read the rows of a table whose first line names its columns, `needed` among them.

    Raises FileNotFoundError, or ValueError naming the file, what is wrong and `fix`.
    """
    reader = csv.DictReader(io.StringIO(read_text(path, most=MOST, fix=fix), newline=""), skipinitialspace=True)
    try:
        lacking = [name for name in needed if name not in (reader.fieldnames or ())]
        if lacking:
            raise refuse(path, f"has no column {', '.join(lacking)}", fix)
        return list(reader)
    except csv.Error as error:
        raise refuse(path, f"is damaged ({error})", fix) from None

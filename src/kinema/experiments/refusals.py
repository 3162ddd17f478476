"""End commands that read their own arguments as `kinema` does: one line for a user's error, and exit code 2."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator


@contextlib.contextmanager
def refusals() -> Iterator[None]:
    """End with exit code 2 where sys.exit(TEXT) alone would give 1."""
    try:
        yield
    except SystemExit as stop:
        if not isinstance(stop.code, str):
            raise
        print(stop.code, file=sys.stderr)
        raise SystemExit(2) from None

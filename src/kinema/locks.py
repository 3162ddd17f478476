"""Let one process at a time do a piece of work."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout


@contextmanager
def hold(path: str | Path, waiting: Callable[[], object] | None = None) -> Iterator[None]:
    """Hold the lock of a file for this thread; `waiting` is called once if another has it, before waiting for it.

    The system frees the lock of a killed process. The file stays: its lock is what counts.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    lock = FileLock(path)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        if waiting is not None:
            waiting()
        lock.acquire()
    try:
        yield
    finally:
        lock.release()

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
    lock = _lock(path)
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


@contextmanager
def attempt(path: str | Path, *, wait: bool = False) -> Iterator[bool]:
    """Hold the lock of a file if no other has it, and say whether it is held; `wait` for it, and it is."""
    lock = _lock(path)
    try:
        lock.acquire(timeout=-1 if wait else 0)
    except Timeout:
        yield False
        return
    try:
        yield True
    finally:
        lock.release()


def _lock(path: str | Path) -> FileLock:
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    return FileLock(path)

"""Let one process at a time do a piece of work, by locks that the system frees when their process ends."""

from __future__ import annotations

import errno
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

NO_LOCKS = (errno.ENOSYS, errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP)
"""What a file system answers that has no flock: Lustre mounted without it, NFS without its lock daemon, some FUSE."""


@contextmanager
def hold(path: str | Path, waiting: Callable[[], object] | None = None) -> Iterator[None]:
    """Hold the lock of a file for this thread; `waiting` is called once if another has it, before waiting for it.

    The system frees the lock of a killed process. The file stays: its lock is what counts. Raises OSError naming the
    file and the fix on a file system without locks.
    """
    lock = _lock(path)
    try:
        _acquire(lock, 0)
    except Timeout:
        if waiting is not None:
            waiting()
        _acquire(lock)
    try:
        yield
    finally:
        lock.release()


@contextmanager
def attempt(path: str | Path, *, wait: bool = False) -> Iterator[bool]:
    """Hold the lock of a file if no other has it, and say whether it is held; `wait` for it, and it is.

    Raises as `hold`.
    """
    lock = _lock(path)
    try:
        _acquire(lock, -1 if wait else 0)
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
    # Without flock there is no lock: one that is a file alone would outlive a killed process, for ever on another host.
    return FileLock(path, fallback_to_soft=False)


def _acquire(lock: FileLock, timeout: float = -1) -> None:
    """Take a lock within so many seconds (-1: any number); raises Timeout, or OSError as `hold` says."""
    try:
        lock.acquire(timeout=timeout)
    except OSError as error:
        if error.errno not in NO_LOCKS:
            raise
        told = (
            f"{error.strerror}: {lock.lock_file} can't be locked, its file system has no flock; set KINEMA_RUNS, "
            "KINEMA_CACHE and KINEMA_STORES to folders of one that has, or have it mounted with locks "
            "(Lustre: -o flock, NFS: version 4)"
        )
        raise OSError(error.errno, told) from error

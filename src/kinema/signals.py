"""End work that a signal interrupts as an exit that is no success, and not as an error of the work."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class Interrupted(SystemExit):
    """Say which signal ended work that can go on, and where; the exit code is the shell's (130: Ctrl-C, 143: SIGTERM).

    An exit, no Exception: whatever runs several pieces of work stops with it. `told`: its line was printed.
    """

    told = False

    def __init__(self, signum: int, where: str = "", onwards: str = "") -> None:
        super().__init__(signum, where, onwards)  # all, since processes hand exceptions on by their arguments
        self.signum, self.where, self.onwards, self.code = signum, where, onwards, 128 + signum

    def __str__(self) -> str:
        name = signal.Signals(self.signum).name
        return f"interrupted{self.where} ({name}); run the same command again to go on{self.onwards}"


@contextmanager
def interruptible() -> Iterator[None]:
    """Turn SIGTERM and Ctrl-C into Interrupted, so that what runs inside is ended in order.

    Whoever handles SIGTERM already (submitit, which puts its jobs into the queue again) goes on doing so. Other threads
    than the main one get no signals.
    """
    main = threading.current_thread() is threading.main_thread()
    mine = main and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    if mine:
        signal.signal(signal.SIGTERM, _interrupt)
    try:
        yield
    except KeyboardInterrupt:
        raise Interrupted(signal.SIGINT) from None
    finally:
        if mine:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)


def ended_by_signal(code: int) -> int | None:
    """Return the signal that a process' exit code tells of: its own (-15), or an Interrupted's (143)."""
    signum = -code if code < 0 else code - 128
    return signum if signum in (signal.SIGINT, signal.SIGTERM) else None


def _interrupt(signum: int, _: FrameType | None) -> None:
    raise Interrupted(signum)

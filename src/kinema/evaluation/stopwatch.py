"""Time what is done motion by motion, device included."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

import torch

from kinema.devices import synchronize


class Stopwatch:
    """Add up the seconds of some blocks, and the motions that were made in them."""

    def __init__(self, device: torch.device) -> None:
        self.device, self.seconds, self.count = device, 0.0, 0

    @contextmanager
    def motions(self, count: int) -> Iterator[None]:
        """Time a block that makes so many motions, with all that the device was asked to do in it."""
        synchronize(self.device)
        started = time.perf_counter()
        yield
        synchronize(self.device)
        self.seconds, self.count = self.seconds + time.perf_counter() - started, self.count + count

    def take(self) -> float | None:
        """Return the seconds of a motion since the last call, None if there was none, and begin anew."""
        found = self.seconds / self.count if self.count else None
        self.seconds, self.count = 0.0, 0
        return found

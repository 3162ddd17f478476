"""Measure how fast a run trains, and what share of the time it waits for data."""

from __future__ import annotations

import time
from collections import defaultdict

from lightning.pytorch.profilers import Profiler


class Pace(Profiler):
    """Add up the seconds of the actions that Lightning names: none is kept singly, as its own profilers do."""

    WAIT = "[_TrainingEpochLoop].train_dataloader_next"
    ASIDE = "aside"
    """What is no training: validation, samples, scores."""

    def __init__(self) -> None:
        super().__init__()
        self.spent: defaultdict[str, float] = defaultdict(float)
        self.begun: dict[str, float] = {}
        self.restart(0)

    def start(self, action_name: str) -> None:
        """Begin an action."""
        self.begun[action_name] = time.monotonic()

    def stop(self, action_name: str) -> None:
        """End it."""
        if (begun := self.begun.pop(action_name, None)) is not None:
            self.spent[action_name] += time.monotonic() - begun

    def restart(self, step: int) -> None:
        """Begin to count at a step."""
        self.spent.clear()
        self.step, self.since = step, time.monotonic()

    def rates(self, step: int) -> dict[str, float]:
        """Return steps a second and the share of waiting since the last call, and begin anew."""
        seconds = max(time.monotonic() - self.since - self.spent[self.ASIDE], 1e-9)
        found = {
            "pace/steps_per_second": (step - self.step) / seconds,
            "pace/data_wait": min(1.0, self.spent[self.WAIT] / seconds),
        }
        self.restart(step)
        return found

"""Lay the times of a flow's steps, from noise (0) to data (1)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

EARLIEST, LATEST = 0.05, 20.0
"""Signal over noise between which the grid "emergence" lays its times: components of deviation 20 and of .05."""


def uniform(steps: int, source_scale: float) -> list[float]:
    """Take equal steps."""
    return [i / steps for i in range(steps + 1)]


def emergence(steps: int, source_scale: float) -> list[float]:
    """Take steps of equal ratio of signal to noise, t = s rho / (1 + s rho) (FRONTIER §9.5).

    A component of deviation d overtakes noise of scale s where t / (1 - t) = s / d: at .83 for d = 1 and s = 5, so that
    equal steps of t spend most evaluations before anything is decided.
    """
    count = steps - 1
    ends = math.log(EARLIEST), math.log(LATEST)
    shares = [0.5] if count == 1 else [i / (count - 1) for i in range(count)]
    ratios = [source_scale * math.exp(ends[0] + share * (ends[1] - ends[0])) for share in shares]
    return [0.0, *(ratio / (1 + ratio) for ratio in ratios), 1.0]


def nested(times: Sequence[float], steps: int) -> list[float]:
    """Leave every second time of a grid out until `steps` steps are left, each of which is two of twice as many.

    Equal steps stay equal, and so do equal ratios: `emergence` keeps its middle, t = s / (1 + s). A grid laid for fewer
    steps would share no times with the finer one. Raises ValueError where halving doesn't lead to that number.
    """
    finest = len(times) - 1
    if steps < 1 or finest % steps or (finest // steps).bit_count() != 1:
        halves = ", ".join(str(finest >> k) for k in range((finest & -finest).bit_length()))
        raise ValueError(f"{steps} steps are not of a grid of {finest}; halving it leaves {halves}")
    return list(times[:: finest // steps])


GRIDS: dict[str, Callable[[int, float], Sequence[float]]] = {"uniform": uniform, "emergence": emergence}

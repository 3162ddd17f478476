"""Average replications over training seeds."""

from __future__ import annotations

import math


def over_seeds(found: list[list[dict[str, float]]]) -> list[dict[str, float]]:
    """Return the replications of one seed as they are, of several seeds the mean of each seed's replications."""
    return found[0] if len(found) == 1 else [_mean(lines) for lines in found]


def _mean(lines: list[dict[str, float]]) -> dict[str, float]:
    keys = [key for key in lines[0] if all(key in line for line in lines)]
    return {key: math.fsum(line[key] for line in lines) / len(lines) for key in keys}

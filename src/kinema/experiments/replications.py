"""Read the replications of an evaluation, and average them over training seeds."""

from __future__ import annotations

import math
from collections.abc import Collection
from pathlib import Path
from typing import Any

from kinema.files.json import NUMBER, Each
from kinema.runs.lines import read_lines

REPLICATIONS = "replications.jsonl"
EACH = "seconds_per_motion"
"""What a line has of the clock, not of the motion: no metric, since the same replication takes another time."""

LINE = {
    "replication": int,
    "metrics": Each(NUMBER),
    "breakdowns": Each(Each(Each(NUMBER))),
    "provenance": dict,
    "seconds": NUMBER,
    EACH: int | float | None,
    "unread": list | None,
}
"""What a replication's line holds."""


def scored_lines(folder: Path) -> list[dict[str, Any]]:
    """Read the replications that an evaluation's folder holds.

    Raises ValueError naming a line that is damaged: results are never made again in silence.
    """
    return read_lines(folder / REPLICATIONS, LINE)


def whole_lines(folder: Path, judges: Collection[str]) -> list[dict[str, Any]]:
    """Read the replications that have the scores of some judges: of an optional one a line may say that it lacks them.

    Raises ValueError as `scored_lines`.
    """
    lines = scored_lines(folder)
    return [line for line in lines if not any(name in judges for name in map(str, line.get("unread") or ()))]


def over_seeds(found: list[list[dict[str, float]]]) -> list[dict[str, float]]:
    """Return the replications of one seed as they are, of several seeds the mean of each seed's replications."""
    return found[0] if len(found) == 1 else [_mean(lines) for lines in found]


def over_replications(found: list[list[dict[str, float]]]) -> list[dict[str, float]]:
    """Return the mean over training seeds of each replication.

    The same replication has the same captions, crops and noise in all of them: what these means vary by is the
    evaluation's own draws.
    """
    return [_mean(list(lines)) for lines in zip(*found, strict=True)]


def _mean(lines: list[dict[str, float]]) -> dict[str, float]:
    keys = [key for key in lines[0] if all(key in line for line in lines)]
    return {key: math.fsum(line[key] for line in lines) / len(lines) for key in keys}

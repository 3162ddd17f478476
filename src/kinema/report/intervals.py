"""Turn a metric's values by replication into a mean and its 95 % interval."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from scipy.special import stdtrit

Form = Literal["student", "published"]
FORMS: tuple[Form, ...] = ("student", "published")
PUBLISHED_COUNT = 20
"""Replications of the papers' protocol: from there on both forms are the papers'."""


@dataclass(frozen=True)
class Value:
    """Hold a mean, the half-width of its 95 % interval (None: unknown) and how many values it rests on.

    `fewer`: not all of the row's replications or seeds have this metric, which the text says.
    """

    mean: float
    half: float | None
    count: int | None = None
    fewer: bool = False

    def text(self, digits: int) -> str:
        """Write the value with its interval, e.g. `0.500 ± 0.004`; an interval is never rounded to nothing."""
        if not math.isfinite(self.mean):
            return "not finite"
        mean = f"{self.mean:.{digits}f}"
        told = f" (n = {self.count})" if self.fewer else ""
        if self.half is None:
            return mean + told
        half = f"{self.half:.{digits}f}"
        if self.half > 1e-6 and float(half) == 0:  # below, it is what float32 leaves of zero
            half = f"{self.half:.1g}"
        return f"{mean} ± {half}{told}"


def measure(values: Sequence[float], form: Form = "student") -> Value | None:
    """Return the mean and its 95 % interval; one replication has none, no replication has no value.

    Of fewer than 20 values, Student's t with the sample's deviation: the published form is 1.6 times too narrow for 5.
    Else, and always as `published`, 1.96 std / sqrt(n) with the population's deviation (METRICS, Definitions).
    """
    if not values:
        return None
    count = len(values)
    mean = math.fsum(values) / count
    if count == 1 or not math.isfinite(mean):
        return Value(mean, None, count)
    squares = math.fsum((v - mean) ** 2 for v in values)
    if form == "published" or count >= PUBLISHED_COUNT:
        return Value(mean, 1.96 * math.sqrt(squares) / count, count)
    quantile = float(stdtrit(count - 1, 0.975))
    return Value(mean, quantile * math.sqrt(squares / (count - 1) / count), count)


def means(metrics: Sequence[dict[str, float]]) -> dict[str, Value]:
    """Return the mean and 95 % interval of each metric that all replications have."""
    names = [name for name in (metrics[0] if metrics else {}) if all(name in found for found in metrics)]
    values = {name: measure([found[name] for found in metrics]) for name in names}
    return {name: value for name, value in values.items() if value is not None}


def explain(form: Form, counts: Sequence[int]) -> str:
    """Say how the intervals of rows with these numbers of replications were computed."""
    published = "1.96 std / √n"
    few = any(1 < count < PUBLISHED_COUNT for count in counts)
    if form == "published" or not few:
        return published
    return f"Student's t for n < {PUBLISHED_COUNT}" + (f", else {published}" if max(counts) >= PUBLISHED_COUNT else "")

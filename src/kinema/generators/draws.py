"""Hold what a training step draws in one injectable value, and share it out between ranks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Self, TypeVar


@dataclass
class StepDraws:
    """What a training step draws: tensors with a row per sample and, if they have more axes, a column per position."""

    def crop(self, rows: slice, positions: int | None = None) -> Self:
        """Take the draws of some samples and of their first positions."""
        cropped = {f.name: getattr(self, f.name)[rows] for f in fields(self)}
        return type(self)(**{name: v if v.ndim == 1 else v[:, :positions] for name, v in cropped.items()})


Draws = TypeVar("Draws", bound=StepDraws)


def share_of(draw: Callable[[int], Draws], samples: int, shard: tuple[int, int], positions: int | None = None) -> Draws:
    """Draw for the global batch, of which this one is the part `shard` = (rank, world), and take the own share.

    So ranks together see the draws of one process. `draw` makes the draws of a number of samples.
    """
    rank, world = shard
    return draw(samples * world).crop(slice(rank * samples, (rank + 1) * samples), positions)

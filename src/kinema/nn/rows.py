"""Lay the positions of sequences of several lengths behind each other, so that no layer computes padding."""

from __future__ import annotations

from functools import cached_property

import torch
from jaxtyping import Bool, Float, Shaped
from torch import Tensor
from torch.nn import functional as F


class Rows:
    """Know which positions of a batch are real: sequence `owner` and `place` in it of each row.

    Half of a batch is padding where clips are 2 to 10 seconds long: what acts on single positions acts on rows.
    """

    def __init__(self, real: Bool[Tensor, "b n"]) -> None:
        self.real = real
        self.owner, self.place = real.nonzero(as_tuple=True)
        self.taken = self.owner * real.shape[1] + self.place  # one index copies whole rows; two, number by number
        self.whole = len(self.taken) == real.numel()  # nothing to leave out: no copies

    @classmethod
    def of(cls, x: Shaped[Tensor, "b n *c"], real: Bool[Tensor, "b n"] | None = None) -> Rows:
        """Know the positions of `x` that are `real` (None: all)."""
        return cls(torch.ones(x.shape[:2], dtype=torch.bool, device=x.device) if real is None else real)

    @classmethod
    def behind(cls, size: int, real: Bool[Tensor, "b n"]) -> Rows:
        """Know those of sequences that begin with `size` positions more, conditions for instance."""
        return cls(F.pad(real, (size, 0), value=True))

    @cached_property
    def counts(self) -> list[int]:
        """How many rows each sequence has."""
        return self.real.sum(dim=1).tolist()

    def pack(self, x: Shaped[Tensor, "b n *c"]) -> Shaped[Tensor, "m *c"]:
        """Take the real positions."""
        rows = x.flatten(0, 1)
        return rows if self.whole else rows.index_select(0, self.taken)

    def pad(self, rows: Shaped[Tensor, "m *c"]) -> Shaped[Tensor, "b n *c"]:
        """Put rows in their places, zero elsewhere."""
        if not self.whole:
            rows = rows.new_zeros(self.real.numel(), *rows.shape[1:]).index_copy_(0, self.taken, rows)
        return rows.unflatten(0, tuple(self.real.shape))

    def spread(self, values: Float[Tensor, "b c"]) -> Float[Tensor, "m c"]:
        """Give each row what is its sequence's."""
        return values.index_select(0, self.owner)

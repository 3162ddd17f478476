"""Lay the positions of sequences of several lengths behind each other, so that what acts on one computes no padding."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor
from torch.nn import functional as F


class Rows:
    """Know which positions of a batch are real: sequence `owner` and `place` in it of each row.

    Two fifths of a batch are padding where clips are 2 to 10 seconds long: what acts on single positions acts on rows.
    `whole` says that there is no padding; then nothing is copied.
    """

    def __init__(self, real: Bool[Tensor, "b n"], flat: Int[Tensor, " m"] | None = None) -> None:
        # One index copies whole rows; two, number by number.
        self.real, self.flat = real, real.flatten().nonzero()[:, 0] if flat is None else flat
        self.owner, self.place = self.flat // real.shape[1], self.flat % real.shape[1]
        self.whole = len(self.flat) == real.numel()

    @classmethod
    def of(cls, x: Shaped[Tensor, "b n *c"], real: Bool[Tensor, "b n"] | None = None) -> Rows:
        """Know the positions of `x` that are `real` (None: all, which needs no look at the device)."""
        if real is not None:
            return cls(real)
        every = torch.ones(x.shape[:2], dtype=torch.bool, device=x.device)
        return cls(every, torch.arange(every.numel(), device=x.device))

    @classmethod
    def behind(cls, size: int, real: Bool[Tensor, "b n"]) -> Rows:
        """Know those of sequences that begin with `size` positions more, conditions for instance."""
        return cls(F.pad(real, (size, 0), value=True))

    @property
    def counts(self) -> list[int]:
        """How many rows each sequence has."""
        return self.real.sum(dim=1).tolist()

    def pack(self, x: Shaped[Tensor, "b n *c"]) -> Shaped[Tensor, "m *c"]:
        """Take the real positions."""
        rows = x.flatten(0, 1)
        return rows if self.whole else rows.index_select(0, self.flat)

    def pad(self, rows: Shaped[Tensor, "m *c"]) -> Shaped[Tensor, "b n *c"]:
        """Put rows in their places, zero elsewhere."""
        if not self.whole:
            padded = rows.new_zeros(self.real.numel(), *rows.shape[1:])
            padded[self.flat] = rows
            rows = padded
        return rows.unflatten(0, tuple(self.real.shape))

    def spread(self, values: Float[Tensor, "b c"]) -> Float[Tensor, "m c"]:
        """Give each row what is its sequence's."""
        return values.index_select(0, self.owner)

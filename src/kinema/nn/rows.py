"""Lay the positions of sequences of several lengths behind each other, so that no layer computes padding."""

from __future__ import annotations

from jaxtyping import Bool, Float, Shaped
from torch import Tensor


class Rows:
    """Know which positions of a batch are real: sequence `owner` and `place` in it of each row.

    Half of a batch is padding where clips are 2 to 10 seconds long: what acts on single positions acts on rows.
    """

    def __init__(self, real: Bool[Tensor, "b n"]) -> None:
        self.real = real
        self.owner, self.place = real.nonzero(as_tuple=True)
        self.taken = self.owner * real.shape[1] + self.place  # one index copies whole rows; two, number by number

    def pack(self, x: Shaped[Tensor, "b n *c"]) -> Shaped[Tensor, "m *c"]:
        """Take the real positions."""
        return x.flatten(0, 1).index_select(0, self.taken)

    def pad(self, rows: Shaped[Tensor, "m *c"]) -> Shaped[Tensor, "b n *c"]:
        """Put rows in their places, zero elsewhere."""
        x = rows.new_zeros(self.real.numel(), *rows.shape[1:])
        x[self.taken] = rows
        return x.unflatten(0, tuple(self.real.shape))

    def spread(self, values: Float[Tensor, "b c"]) -> Float[Tensor, "m c"]:
        """Give each row what is its sequence's."""
        return values.index_select(0, self.owner)

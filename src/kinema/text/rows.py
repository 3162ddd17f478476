"""Lay several texts in each row of a batch, so that short ones aren't padded to the longest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor


@dataclass(frozen=True)
class SharedRows:
    """Know where each token stands: `row` and `column` of all texts' tokens, one text after the other.

    `owner` says of each place whose it is (-1: nobody's), `place` which token of its text stands there.
    """

    row: Int[Tensor, " m"]
    column: Int[Tensor, " m"]
    owner: Int[Tensor, "r w"]
    place: Int[Tensor, "r w"]

    @classmethod
    def of(cls, lengths: Int[Tensor, " n"], room: int) -> Self:
        """Put the longest first, each into the first row that has room for it; a row has `room` tokens or the longest.

        Half of a batch of captions is padding otherwise, and a transformer computes it.
        """
        sizes: list[int] = lengths.tolist()
        width, free = max(room, *sizes), list[int]()
        starts = [(0, 0)] * len(sizes)
        for text in sorted(range(len(sizes)), key=lambda i: -sizes[i]):
            first = next((i for i, left in enumerate(free) if left >= sizes[text]), len(free))
            if first == len(free):
                free.append(width)
            starts[text] = first, width - free[first]
            free[first] -= sizes[text]
        owner = torch.full((len(free), width - min(free)), -1)
        place = torch.zeros_like(owner)
        each = torch.arange(len(sizes)).repeat_interleave(torch.tensor(sizes))
        before = torch.tensor(sizes).cumsum(0) - torch.tensor(sizes)
        within = torch.arange(len(each)) - before[each]
        row, column = torch.tensor(starts)[each].unbind(1)
        column = column + within
        owner[row, column], place[row, column] = each, within
        return cls(*(part.to(lengths.device) for part in (row, column, owner, place)))

    def lay(self, values: Int[Tensor, "n l"], mask: Bool[Tensor, "n l"]) -> Int[Tensor, "r w"]:
        """Lay what `mask` shows of each text into the rows, 0 elsewhere."""
        laid = values.new_zeros(self.owner.shape)
        laid[self.row, self.column] = values[mask]
        return laid

    def sees(self) -> Bool[Tensor, "r w w"]:
        """Say which places see each other: those of one text, and those of none."""
        return self.owner[:, :, None] == self.owner[:, None, :]

    def take(self, laid: Float[Tensor, "r w k"], mask: Bool[Tensor, "n l"]) -> Float[Tensor, "n l k"]:
        """Take the rows apart again, 0 where `mask` is False."""
        values = laid.new_zeros(*mask.shape, laid.shape[-1])
        values[mask] = laid[self.row, self.column]
        return values

"""Choose what every training step sees: a pure function of seed and step, so that runs resume and ranks agree."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from kinema.seeds import item_seed, stream

LEFTOVERS = ("drop", "keep", "mld")
"""What becomes of a split's rows beyond whole batches: they are left out, form a smaller batch, or (MLD) form one that
counts for all metrics but R-precision and matching."""


class StepSampler:
    """Return the batches of steps `start_step` to `steps`: lists of (index, item seed).

    Every epoch is one permutation of the items, the incomplete last batch dropped. `batch_size` counts the global
    batch; a rank takes its contiguous share of it, so that any number of ranks sees the same batches. `len` counts all
    `steps`, as Lightning expects of a loader it resumes in the middle of.
    """

    def __init__(
        self, size: int, batch_size: int, seed: int, steps: int, start_step: int = 0, rank: int = 0, world: int = 1
    ) -> None:
        if not 1 <= batch_size <= size:
            raise ValueError(f"batch_size {batch_size} must be at least 1 and at most the {size} items of the split")
        if batch_size % world:
            raise ValueError(f"batch_size {batch_size} counts all ranks together; make it a multiple of {world}")
        if not 0 <= rank < world:
            raise ValueError(f"rank {rank} is not below the number of ranks, {world}")
        self.size, self.batch_size, self.seed, self.steps = size, batch_size, seed, steps
        self.start_step, self.rank, self.world = start_step, rank, world

    def __len__(self) -> int:
        return self.steps

    def __iter__(self) -> Iterator[list[tuple[int, int]]]:
        per_epoch, share = self.size // self.batch_size, self.batch_size // self.world
        current, order = -1, np.arange(0)
        for step in range(self.start_step, self.steps):
            epoch, position = divmod(step, per_epoch)
            if epoch != current:
                current, order = epoch, stream(self.seed, epoch).permutation(self.size)
            first = position * self.batch_size + self.rank * share
            chosen = order[first : first + share].tolist()
            yield [(index, item_seed(self.seed, epoch, index)) for index in chosen]

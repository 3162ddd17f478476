"""Hold the numbers of the evaluation protocol (METRICS, MARDM §8)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Interval

from kinema.data.catalog import SPLITS
from kinema.data.sampler import LEFTOVERS
from kinema.options import Count, Number, OneOf, Options, Seed, Several

Replications = Annotated[int, Interval(ge=1, le=10**4)]


@dataclass(frozen=True)
class EvaluationProtocol(Options):
    """Hold the numbers of the protocol; `mm_*` are MultiModality's.

    `leftover`: rows beyond whole pools are left out of everything ("drop", T2M and MARDM), form a smaller pool
    ("keep"), or count for all but R-precision and matching ("mld"). `max_batches` bounds a replication (small runs).
    """

    replications: Replications = 20
    pool: Several = 32
    mm_texts: Number = 96
    mm_repeats: Count = 30
    mm_pairs: Count = 10
    diversity_pairs: Count = 300
    leftover: Annotated[str, OneOf(LEFTOVERS)] = "drop"
    split: Annotated[str, OneOf(SPLITS)] = "test"
    seed: Seed = 0
    max_batches: Count | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.mm_texts and self.mm_repeats < 2:
            raise ValueError(
                f"protocol.mm_repeats={self.mm_repeats}; MultiModality compares at least 2 answers to a caption; "
                "set mm_texts=0 to leave it out"
            )

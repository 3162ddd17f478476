"""Hold the numbers of the evaluation protocol (METRICS, MARDM §8)."""

from __future__ import annotations

from dataclasses import dataclass

from kinema.data.sampler import LEFTOVERS


@dataclass(frozen=True)
class EvaluationProtocol:
    """Hold the numbers of the protocol; `mm_*` are MultiModality's.

    `leftover`: rows beyond whole pools are left out of everything ("drop", T2M and MARDM), form a smaller pool
    ("keep"), or count for all but R-precision and matching ("mld"). `max_batches` bounds a replication (small runs).
    """

    replications: int = 20
    pool: int = 32
    mm_texts: int = 96
    mm_repeats: int = 30
    mm_pairs: int = 10
    diversity_pairs: int = 300
    leftover: str = "drop"
    split: str = "test"
    seed: int = 0
    max_batches: int | None = None

    def __post_init__(self) -> None:
        if self.leftover not in LEFTOVERS:
            raise ValueError(f"protocol.leftover={self.leftover!r}; allowed: {', '.join(LEFTOVERS)}")
        least = {"replications": 1, "pool": 2, "mm_texts": 0, "mm_pairs": 1, "diversity_pairs": 1, "max_batches": 1}
        for name, bound in least.items():
            value = getattr(self, name)
            if value is not None and value < bound:
                raise ValueError(f"protocol.{name}={value}; it must be at least {bound}")
        if self.mm_texts and self.mm_repeats < 2:
            raise ValueError(
                f"protocol.mm_repeats={self.mm_repeats}; MultiModality compares at least 2 answers to a caption; "
                "set mm_texts=0 to leave it out"
            )

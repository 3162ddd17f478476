"""Derive every seed from names and numbers, so that what is drawn depends on what it is for and on nothing else."""

from __future__ import annotations

import hashlib
import secrets

import numpy as np
import torch
from jaxtyping import Int
from torch import Tensor

from kinema.options import Seed, check_value

_MIX = (0xBF58476D1CE4E5B9, 0x94D049BB133111EB)
_GOLDEN = 0x9E3779B97F4A7C15
_MASK = (1 << 64) - 1


def training_seed(*parts: int | str) -> int:
    """Mix names and numbers, such as a run's seed, "train" and a step, into 63 bits for torch's generators."""
    return _digest("/".join(map(str, parts))) >> 1


def word_seed(word: str) -> int:
    """Hash a word to 64 bits (the built-in hash differs between processes)."""
    return _digest(word)


def item_seed(seed: int, epoch: int, index: int) -> int:
    """Hash seed, epoch and item to 64 bits, the seed of that item's own draws (SplitMix64, chained)."""
    state = 0
    for value in (seed, epoch, index):
        state = (state + value + _GOLDEN) & _MASK
        for shift, factor in zip((30, 27), _MIX, strict=True):
            state = ((state ^ (state >> shift)) * factor) & _MASK
        state ^= state >> 31
    return state


def request_seeds(seed: int | list[int] | tuple[int, ...] | None, size: int) -> list[int]:
    """Derive one seed per sample of a request; the first is the seed itself (drawn if None), so that it repeats all.

    A list is taken as it is: one seed per sample.
    """
    if isinstance(seed, list | tuple):
        if len(seed) != size:
            raise ValueError(f"got {len(seed)} seeds for {size} motions; give one, or one per motion")
        return [request_seeds(own, 1)[0] for own in seed]
    seed = secrets.randbelow(2**31) if seed is None else seed
    check_value(seed, Seed, "seed")
    seed = int(seed)  # NumPy's are whole numbers too
    rest = (np.random.SeedSequence([seed, i]).generate_state(1, np.uint64)[0] for i in range(1, size))
    return [seed, *(int(s) >> 16 for s in rest)]


def protocol_seeds(seed: int, replication: int, first: int, count: int, repeat: int = 0) -> Int[Tensor, " b"]:
    """Return the seeds of rows first..first+count-1 of a replication: the same for every source."""
    rows = range(first, first + count)
    words = [np.random.SeedSequence([seed, replication, repeat, row]).generate_state(2) for row in rows]
    return torch.tensor([(int(high) << 31) ^ int(low) for high, low in words], dtype=torch.int64)


def pairs_seed(seed: int, replication: int) -> int:
    """Return the seed of the pairs that a replication's diversity and MultiModality compare."""
    return seed * 1_000_003 + replication


def halves_seed(seed: int, replication: int) -> int:
    """Return the seed by which a replication's real clips are halved."""
    return seed + replication


def stream(*numbers: int) -> np.random.Generator:
    """Make the random numbers of a seed and what they are for, such as an epoch or a clip."""
    return np.random.default_rng(numbers)


def _digest(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little")

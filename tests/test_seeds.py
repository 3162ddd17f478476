"""Seeds are those that runs on disk were made with, tell their parts apart, and are derived in one module."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from kinema import seeds

SOURCES = Path(seeds.__file__).parent


def test_the_numbers_stay():
    assert seeds.training_seed(0, "train", 7) == 675551197400954812
    assert seeds.training_seed(0, "init", "generator") == 1735548067249479395
    assert seeds.word_seed("walk") == 2366461751023594618
    assert seeds.item_seed(3, 5, 70) == 11687682868977270891
    assert seeds.request_seeds(7, 3) == [7, 101249132205575, 278917096422438]
    assert seeds.protocol_seeds(0, 1, 4, 2).tolist() == [770316854851392592, 1813273454326030604]
    assert seeds.protocol_seeds(3, 0, 0, 1, repeat=2).tolist() == [6294228813457374552]
    assert seeds.pairs_seed(2, 5) == 2000011
    assert seeds.halves_seed(2, 5) == 7
    assert seeds.stream(5, 9).integers(0, 1 << 40, 2).tolist() == [731296371946, 843982845657]


def test_item_seeds_differ_by_seed_epoch_and_item():
    found = {seeds.item_seed(s, e, i) for s in range(10) for e in range(10) for i in range(100)}
    assert len(found) == 10_000
    assert all(0 <= seed < 2**64 for seed in found)


@pytest.mark.parametrize("seed", [-1, 2**63])
def test_a_seed_that_torch_cannot_take_is_refused(seed):
    with pytest.raises(ValueError, match=rf"seed={seed}: must be a whole number"):
        seeds.request_seeds(seed, 2)


def test_a_seed_that_numpy_drew_is_a_seed():
    drawn = np.random.default_rng(0).integers(1000)
    found = seeds.request_seeds(drawn, 2)
    assert found == seeds.request_seeds(int(drawn), 2)
    assert [type(seed) for seed in found] == [int, int]


def test_seeds_are_derived_nowhere_else():
    # A generator of one given seed is no derivation; a list of numbers, a hash or arithmetic makes another seed of it.
    derivation = re.compile(r"SeedSequence|default_rng\(\s*[\[(]|(?:default_rng|manual_seed)\([^()]*(?:[+*^]|hash)")
    found = {str(file.relative_to(SOURCES)) for file in SOURCES.rglob("*.py") if derivation.search(file.read_text())}
    assert found == {"seeds.py"}

"""An oracle answers with what it knows and nothing more, each row by its own seed."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from kinema.data.labels import Shown, require_labels
from kinema.data.store import PackedStore
from kinema.evaluation.oracle import KNOWS, Oracle
from kinema.types import MotionBatch

ACTIONS, STYLES = ("walk", "bow", "sit"), ("sad", "old", None)
labels = st.builds(Shown, st.sampled_from(ACTIONS), st.sampled_from(STYLES), st.booleans())
corpora = st.lists(labels, min_size=4, max_size=20).filter(
    lambda found: all(len({one for one in found if one.mirrored == side}) > 1 for side in (True, False))
)


class Clips:
    """Hold clips whose every number is their entry's."""

    def entry_captions(self, entry):
        return []

    def frames_of(self, entry):
        return np.full((8 + 3 * (entry % 9), 5), entry, np.float32)


def oracle(trained: list[Shown], tested: list[Shown], knows: str) -> Oracle:
    """Make an oracle of entries 1, 2, ...; those of the prompts stand behind them."""
    return Oracle(Clips(), range(1, len(trained) + 1), [None, *trained, *tested].__getitem__, knows=knows)


def prompts(first: int, size: int) -> MotionBatch:
    """Make prompts of 4, 8, 12, ... frames."""
    lengths = 4 * torch.arange(1, size + 1)
    return MotionBatch(torch.ones(size, 4 * size, 5), lengths, first + torch.arange(size), torch.zeros_like(lengths))


def answers(found: MotionBatch) -> list[int]:
    return found.features[:, 0, 0].int().tolist()


@pytest.mark.parametrize("knows", KNOWS)
@given(trained=corpora, tested=st.lists(labels, min_size=1, max_size=8), seed=st.integers(0, 2**40))
def test_what_it_knows_is_right_and_the_other_wrong(knows, trained, tested, seed):
    source, batch = oracle(trained, tested, knows), prompts(len(trained) + 1, len(tested))
    found = source(batch, seed + torch.arange(len(tested)))
    knew = 0
    for prompt, entry in zip(tested, answers(found), strict=True):
        told = trained[entry - 1]
        assert told.mirrored == prompt.mirrored
        if knows == "action":
            right = [one for one in trained if one.action == prompt.action and one.style != prompt.style]
            right += [one for one in trained if prompt.style is None and one.action == prompt.action]
        else:
            right = [one for one in trained if one.style == prompt.style and one.action != prompt.action]
            right = right if prompt.style else []
        right = [one for one in right if one.mirrored == prompt.mirrored]
        assert told in right if right else told != prompt
        knew += bool(right)
    assert source.measured() == {"oracle_knew": knew / len(tested)}
    assert source.measured() == {"oracle_knew": 0}


@pytest.mark.parametrize("knows", KNOWS)
@given(trained=corpora, tested=st.lists(labels, min_size=2, max_size=8), turn=st.integers(1, 7))
def test_a_row_depends_on_its_own_prompt_and_seed_alone(knows, trained, tested, turn):
    source, batch = oracle(trained, tested, knows), prompts(len(trained) + 1, len(tested))
    seeds = 7 + torch.arange(len(tested))
    whole = source(batch, seeds)
    rows = torch.arange(len(tested)).roll(turn)[1:]
    some = MotionBatch(batch.features[rows], batch.lengths[rows], batch.entries[rows], batch.starts[rows])
    part = oracle(trained, tested, knows)(some, seeds[rows])
    assert answers(part) == [answers(whole)[i] for i in rows.tolist()]
    assert torch.equal(part.lengths, whole.lengths[rows])


def test_answers_are_as_long_as_the_prompt_or_as_the_clip_in_whole_units():
    trained = [Shown("walk", "sad", False), Shown("walk", "old", False)]  # of 11 and 14 frames
    found = oracle(trained, [trained[0]] * 4, "action")(prompts(3, 4), torch.arange(4))
    assert answers(found) == [2] * 4
    assert found.lengths.tolist() == [4, 8, 12, 12]
    assert not found.features[~found.mask].any()


def test_all_clips_that_fit_are_drawn():
    trained = [Shown("walk", style, False) for style in ("old", "sad", "sad", "gay")]
    source = oracle(trained, [trained[0]] * 90, "action")
    drawn = answers(source(prompts(5, 90), torch.arange(90)))
    assert {entry: drawn.count(entry) > 15 for entry in (2, 3, 4)} == dict.fromkeys((2, 3, 4), True)
    assert answers(source(prompts(5, 90), torch.arange(90))) == drawn


def test_bad_input_is_named():
    with pytest.raises(ValueError, match="an oracle knows 'length'; allowed: action, style"):
        oracle([Shown("walk", None, False), Shown("sit", None, False)], [], "length")
    with pytest.raises(ValueError, match="fewer than two labels"):
        oracle([Shown("walk", None, False)] * 3, [], "action")


def test_a_corpus_without_labels_is_told_what_is_missing():
    store = object.__new__(PackedStore)
    store.manifest = {"name": "own", "fields": ["source"]}
    with pytest.raises(ValueError, match=r"corpus 'own' doesn't say .* 'label' .* only \['source'\]; add one"):
        require_labels(store)

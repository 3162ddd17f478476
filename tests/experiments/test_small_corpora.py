"""A small corpus of one's own trains, or is refused before the first stage with the key to set."""

from __future__ import annotations

import pytest

from kinema.data.store import PackedStore
from kinema.experiments.config import compose
from kinema.experiments.corpus import open_corpus, require_pool, require_windows
from kinema.experiments.evaluation import run_evaluation
from kinema.experiments.run import run_stage

pytestmark = pytest.mark.usefixtures("unchecked")


@pytest.fixture
def small(overrides):
    """Give the overrides of a micro run on thirty clips, most of them for training."""
    return [*overrides, "data.options.size=30"]


@pytest.mark.parametrize("batch", [16, 64, 1000])
def test_a_batch_larger_than_the_split_trains_and_says_so(small, capsys, batch):
    cfg = compose([*small, "stage=length", f"length.train.batch_size={batch}", "length.train.steps=2"])
    items = len(PackedStore.open(open_corpus(cfg)).split_entries("train"))
    run = run_stage(cfg, "length")
    assert run.done
    said = " ".join(capsys.readouterr().out.split())
    told = f"length.train.batch_size={batch}, but the train split has {items} clips: a batch is all"
    assert (told in said) is (batch > items)


@pytest.mark.parametrize(("pool", "leftover", "fits"), [(2, "drop", True), (32, "drop", False), (32, "keep", True)])
def test_fewer_test_clips_than_a_pool_are_told_with_the_keys(small, pool, leftover, fits):
    cfg = compose([*small, f"scale.protocol.pool={pool}", f"scale.protocol.leftover={leftover}"])
    store = PackedStore.open(open_corpus(cfg))
    if fits:
        require_pool(cfg, store)
        return
    keys = r"set scale.protocol.leftover=keep .* or scale.protocol.pool=\d+"
    with pytest.raises(ValueError, match=keys):
        require_pool(cfg, store)


def test_nothing_is_made_for_a_row_that_cannot_be_scored(small, tmp_path):
    cfg = compose([*small, "source=real", "scale.protocol.pool=32", "scale.protocol.leftover=drop"], "evaluate")
    with pytest.raises(ValueError, match="fewer than a pool of 32"):
        run_evaluation(cfg)
    assert not list(tmp_path.rglob("weights.safetensors"))


def test_windows_longer_than_every_clip_are_told_first(small):
    store = PackedStore.open(open_corpus(compose(small)))
    with pytest.raises(ValueError, match=r"none of .* clips has 500 frames; use a smaller window or longer clips"):
        require_windows(store, 500, False, "train")
    with pytest.raises(ValueError, match=r"none of .* clips has 500 frames"):
        run_stage(compose([*small, "tokenizer.train.window=500"]), "tokenizer")

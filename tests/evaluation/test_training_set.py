"""Training motion is embedded once for each judge, whole; twins and parts of a clip are no strangers to each other."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from kinema.data.origin import ORIGIN
from kinema.data.prepare import prepare_store
from kinema.data.store import PackedStore
from kinema.evaluation.cache import EmbeddingCache
from kinema.evaluation.training_set import TrainingSet, origins_of
from kinema.types import MotionBatch


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    """Give a small synthetic corpus whose training split has mirrored clips and time-tagged parts."""
    return PackedStore.open(prepare_store("synthetic", None, tmp_path_factory.mktemp("s"), name="s", size=20))


@pytest.fixture
def count(monkeypatch, make):
    """Give an evaluator and the motions that it has embedded."""
    model, seen = make.matching(), []
    embed = model.embed_motion
    monkeypatch.setattr(model, "embed_motion", lambda batch: seen.extend(batch.entries.tolist()) or embed(batch))
    return model, seen


@pytest.mark.parametrize("known", [True, False])
def test_twins_and_parts_lie_in_one_take(store, known, monkeypatch):
    entries = store.split_entries("train", captions_required=False)
    takes = np.full(store.num_clips, -1, dtype=ORIGIN)
    if known:  # two originals to a take, a hundred frames apart
        names = [store.clip_name(clip).removeprefix("M") for clip in range(store.num_clips)]
        number = np.unique(names, return_inverse=True)[1]
        takes["take"], takes["start"] = number // 2, 300 * (number % 2)
        takes["stop"] = takes["start"] + store.clips["frames"]
    monkeypatch.setattr(store, "origins", takes)
    origins = dict(zip(map(store.entry_name, entries.tolist()), origins_of(store, entries).tolist(), strict=True))
    for name, (take, start, stop) in origins.items():
        whole = origins[name.removeprefix("M").split("#")[0]]
        assert take == whole[0]
        assert whole[1] <= start < stop <= whole[2]
    assert any(origins[name][2] < origins[name.split("#")[0]][2] for name in origins if "#" in name)
    places = {tuple(origin) for name, origin in origins.items() if "#" not in name}
    assert len(places) == len({name.removeprefix("M") for name in origins if "#" not in name})
    assert (len({take for take, _, _ in places}) < len(places)) == known


def test_whole_training_motions_are_embedded_once(store, count, tmp_path):
    model, seen = count
    found = TrainingSet.embedded(store, model, EmbeddingCache(tmp_path, store.hash))
    entries = store.split_entries("train", captions_required=False)
    assert sorted(seen) == entries.tolist()
    again = TrainingSet.embedded(store, model, EmbeddingCache(tmp_path, store.hash))
    assert len(seen) == len(entries)
    assert torch.equal(again.embeddings, found.embeddings)
    assert torch.equal(again.isolation, found.isolation)
    assert [path.name for path in tmp_path.rglob("*.npz")] == [f"{store.hash}-train.npz"]
    with torch.no_grad():
        alone = [model.embed_motion(one(store, entry)) for entry in entries]
    between = torch.cdist(torch.cat(alone).double(), found.embeddings.double())
    assert between.min(1).values.max() < 1e-4  # each is there, whatever it shared its batch with
    assert (found.isolation > 0).all()
    TrainingSet.embedded(store, model, EmbeddingCache(tmp_path, "another corpus"))
    assert len(seen) == 3 * len(entries)


def one(store, entry):
    frames = np.array(store.frames_of(int(entry)))
    frames = frames[: len(frames) // 4 * 4, :67]
    return MotionBatch(torch.from_numpy(frames)[None], torch.tensor([len(frames)]), torch.tensor([int(entry)]))


def test_a_twin_would_hide_a_copy(store, count, tmp_path):
    """Own distances are to other clips: at least as large as to all other entries, and larger for some."""
    found = TrainingSet.embedded(store, count[0], EmbeddingCache(tmp_path, store.hash))
    between = torch.cdist(found.embeddings.double(), found.embeddings.double()).fill_diagonal_(torch.inf)
    nearest = between.min(1).values
    assert (found.isolation >= nearest - 1e-6).all()
    assert (found.isolation > nearest + 1e-6).any()

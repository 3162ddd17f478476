"""Training motion is embedded once for each judge, whole; twins and parts of a clip are no strangers to each other."""

from __future__ import annotations

import numpy as np
import pytest
import torch

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


def test_twins_and_parts_are_of_one_origin(store):
    entries = store.split_entries("train", captions_required=False)
    origins = origins_of(store, entries)
    groups = {}
    for entry, origin in zip(entries.tolist(), origins.tolist(), strict=True):
        groups.setdefault(origin, []).append(store.entry_name(entry))
    originals = {name.split("#")[0].removeprefix("M") for names in groups.values() for name in names}
    assert len(groups) == len(originals) < len(entries) / 2
    for names in groups.values():
        assert len({name.split("#")[0].removeprefix("M") for name in names}) == 1
    assert max(map(len, groups.values())) == 4  # a clip, a part of it, and their mirror images


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

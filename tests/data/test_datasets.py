from __future__ import annotations

import numpy as np
import pytest
import torch

from kinema.data.collate import collate
from kinema.data.datasets import ClipDataset, WindowDataset, crop_frames
from kinema.data.prepare import prepare_store
from kinema.data.store import PackedStore


@pytest.fixture
def lengths_store(official_corpus, tmp_path):
    clips = {"a": ("train", 63), "b": ("train", 64), "c": ("train", 66), "d": ("train", 230), "e": ("val", 63)}
    return PackedStore.open(prepare_store("official", official_corpus(clips), tmp_path / "o", name="x"))


def test_windows_are_all_starts_of_all_clips(lengths_store):
    data = WindowDataset(lengths_store, "train", 64)
    assert len(data) == 1 + 3 + 167
    assert data.skipped == 1
    located = [data.locate(i) for i in range(len(data))]
    assert located == [(row, start) for row, count in enumerate((1, 3, 167)) for start in range(count)]
    item = data[3, 0]
    np.testing.assert_array_equal(item.features, lengths_store.clip_frames(2)[2:66])
    assert (item.entry, item.start, item.name) == (2, 2, "c")


def test_windows_end_with_the_split(lengths_store):
    data = WindowDataset(lengths_store, "train", 64)
    with pytest.raises(IndexError):
        data.locate(len(data))
    with pytest.raises(ValueError, match="none of 1 clips has 64 frames"):
        WindowDataset(lengths_store, "val", 64)


def test_an_item_is_a_function_of_index_and_seed(store):
    data = ClipDataset(store, "train")
    same, other = data[2, 5], data[2, 5]
    np.testing.assert_array_equal(same.features, other.features)
    assert same.caption == other.caption
    drawn = {(data[2, seed].start, len(data[2, seed].features), data[2, seed].caption.text) for seed in range(99)}
    assert len(drawn) > 5


def test_crops_have_the_published_distribution(store):
    data = ClipDataset(store, "train")
    items = [data[4, seed] for seed in range(3000)]
    length = int(store.entries["frames"][items[0].entry])
    most, less = crop_frames(length, 4)
    sizes = np.array([len(i.features) for i in items])
    assert set(sizes) == {most, less}
    assert abs((sizes == most).mean() - 2 / 3) < 0.04  # 4.6 standard errors
    starts = np.array([i.start for i in items])[sizes == less]
    assert set(starts) == set(range(length - less + 1))
    captions = [i.caption.text == "they jump" for i in items if not store.entries["mirrored"][i.entry]]
    assert abs(np.mean(captions) - 0.5) < 0.05


def test_crops_lists_every_crop_there_can_be(store):
    data = ClipDataset(store, "train")
    entry = int(data.entries[4])
    listed = data.crops(entry)
    drawn = {(item.start, len(item.features)) for item in (data[4, seed] for seed in range(500))}
    assert drawn == set(listed)
    assert len(set(listed)) == len(listed) <= 12


@pytest.mark.parametrize(("length", "wanted"), [(40, (40, 36)), (43, (40, 36)), (199, (196, 192)), (5, (4, 4))])
def test_crop_lengths(length, wanted):
    assert crop_frames(length, 4) == wanted


def test_length_bounds_narrow_the_filter(store):
    data = ClipDataset(store, "train", min_frames=70, max_frames=90)
    frames = store.entries["frames"][data.entries]
    assert frames.min() >= 70
    assert frames.max() < 90
    with pytest.raises(ValueError, match="500 <= frames < 600"):
        ClipDataset(store, "train", min_frames=500, max_frames=600)


def test_batches_are_padded_with_zeros_and_keep_the_items(store):
    data = ClipDataset(store, "test")
    items = [data[i, i] for i in range(len(data))]
    batch = collate(items)
    assert batch.features.shape == (len(data), int(batch.lengths.max()), 263)
    assert batch.features.dtype == torch.float32
    assert batch.features[~batch.mask].abs().sum() == 0
    for row, item in enumerate(items):
        np.testing.assert_array_equal(batch.features[row, : batch.lengths[row]].numpy(), item.features)
        source = store.frames_of(int(batch.entries[row]))[batch.starts[row] :][: batch.lengths[row]]
        np.testing.assert_array_equal(source, item.features)
    assert len(batch.captions) == len(batch.clip_ids) == len(data)


def test_batch_order_does_not_change_items(store):
    data = ClipDataset(store, "test")
    items = [data[i, i] for i in range(6)]
    there, back = collate(items), collate(items[::-1])
    torch.testing.assert_close(there.features, back.features.flip(0))


def test_a_batch_owns_its_memory(store):
    batch = collate([ClipDataset(store, "test")[0, 0]])
    batch.features += 1
    PackedStore.open(store.path).verify()


def test_a_corpus_without_captions_serves_windows_but_no_captioned_clips(joints_corpus, tmp_path):
    root = joints_corpus({"a": ("train", 80, None)})
    store = PackedStore.open(prepare_store("joints", root, tmp_path / "o", name="mute"))
    assert len(WindowDataset(store, "train")) == 32
    with pytest.raises(ValueError, match="'mute', split 'train' has no captions"):
        ClipDataset(store, "train")
    item = ClipDataset(store, "train", captions_required=False)[0, 0]
    assert item.caption is None
    assert collate([item]).captions == []

from __future__ import annotations

import json
import pickle
import shutil

import numpy as np
import pytest

from kinema.data.captions import parse_captions
from kinema.data.catalog import Clip
from kinema.data.prepare import prepare
from kinema.data.store import PackedStore


def test_frames_are_views_of_the_mapped_file(store):
    entry = int(store.split_entries("test")[0])
    frames = store.frames_of(entry)
    assert np.shares_memory(frames, store.features)
    assert not frames.flags.writeable


def test_pickle_holds_the_path_only(store):
    data = pickle.dumps(store)
    assert len(data) < 1000
    again = pickle.loads(data)
    np.testing.assert_array_equal(again.frames_of(3), store.frames_of(3))
    assert again.hash == store.hash


def test_splits_are_disjoint_and_complete(store):
    entries = np.concatenate([store.split_entries(s) for s in ("train", "val", "test")])
    assert sorted(entries) == list(range(store.num_entries))
    with pytest.raises(ValueError, match="'dev' is not one of"):
        store.split_entries("dev")


def test_captions_and_fields_survive_in_any_script(tmp_path):
    features = np.ones((50, 263), np.float32) * np.linspace(0, 1, 50)[:, None]
    lines = "un homme s'étire #1#l'homme/NOUN#0#0\n歩く##0#0"
    clips = [
        Clip("α", "train", parse_captions(lines), {"source": "mocap é"}, features=lambda: features),
        Clip("β", "train", [], {"label": "none"}, features=lambda: features),
    ]
    store = PackedStore.open(prepare(clips, tmp_path / "s", name="x", mirror=False))
    assert [c.text for c in store.entry_captions(0)] == ["un homme s'étire #1", "歩く"]
    assert store.entry_captions(0)[0].tokens == ("l'homme/NOUN",)
    assert store.entry_captions(1) == []
    assert store.fields == ("source", "label")
    assert [store.entry_field(e, "source") for e in (0, 1)] == ["mocap é", ""]
    assert store.split_entries("train").tolist() == [0]
    assert store.split_entries("train", captions_required=False).tolist() == [0, 1]
    with pytest.raises(ValueError, match=r"no field 'colour'; it has \['source', 'label'\]"):
        store.entry_field(0, "colour")


def test_a_folder_that_is_no_store_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="prepare_store"):
        PackedStore.open(tmp_path)


def test_truncated_and_altered_files_are_noticed(store):
    blob = store.path / "strings.utf8"
    text = blob.read_bytes()
    blob.write_bytes(b"X" + text[1:])
    assert PackedStore.open(store.path).verify() == ["strings.utf8"]
    blob.write_bytes(text[:-1])
    with pytest.raises(ValueError, match=r"strings\.utf8 has .* expected; delete the folder"):
        PackedStore.open(store.path)


def test_a_store_of_another_format_is_refused(store):
    manifest = json.loads((store.path / "manifest.json").read_text())
    (store.path / "manifest.json").write_text(json.dumps(manifest | {"format": 99}))
    with pytest.raises(ValueError, match="format 99"):
        PackedStore.open(store.path)


@pytest.mark.parametrize(
    "value",
    ["../../../home", "/etc", "..", "", "a" * 11, "A" * 12, "abc/def/ghij", "12345678901\n", None, 123456789012.5],
)
def test_a_hash_that_is_no_hash_is_refused_since_folders_are_named_by_it(store, tmp_path, value):
    folder = shutil.copytree(store.path, tmp_path / "store")
    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps({**manifest, "hash": value}))
    with pytest.raises(ValueError, match=r"manifest\.json says hash=.*, no 12 hexadecimal digits"):
        PackedStore.open(folder)

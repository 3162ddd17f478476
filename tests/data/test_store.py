from __future__ import annotations

import json
import os
import pickle
import re

import numpy as np
import pytest

from kinema.data.captions import parse_captions
from kinema.data.catalog import Clip
from kinema.data.doctor import diagnose
from kinema.data.integrity import FEATURES, STAMP, _checksum, checksum, write_stamp
from kinema.data.prepare import prepare
from kinema.data.store import FILES, PackedStore


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
    with pytest.raises(ValueError, match=r"strings\.utf8 was changed.*; delete the folder"):
        PackedStore.open(store.path)
    blob.write_bytes(text[:-1])
    with pytest.raises(ValueError, match=r"strings\.utf8 has .* expected; delete the folder"):
        PackedStore.open(store.path)


def test_a_store_of_another_format_is_refused(store):
    manifest = json.loads((store.path / "manifest.json").read_text())
    (store.path / "manifest.json").write_text(json.dumps(manifest | {"format": 99}))
    with pytest.raises(ValueError, match="format 99"):
        PackedStore.open(store.path)


def edit(file, at: int) -> None:
    """Change one byte in place, under the same size."""
    content = bytearray(file.read_bytes())
    content[at] ^= 1
    file.write_bytes(content)


@pytest.mark.parametrize("name", sorted(FILES))
@pytest.mark.parametrize("share", [0, 0.5, 1])
def test_a_change_under_the_same_size_is_noticed(store, name, share):
    file = store.path / name
    edit(file, int(share * (file.stat().st_size - 1)))
    with pytest.raises(ValueError, match=rf"{re.escape(name)} was changed.*; delete the folder and prepare it again"):
        PackedStore.open(store.path)


def test_features_are_read_again_only_where_they_may_have_changed(store, monkeypatch, capsys):
    read = []
    monkeypatch.setattr("kinema.data.integrity.checksum", lambda file: read.append(file.name) or checksum(file))
    _checksum.cache_clear()
    PackedStore.open(store.path)
    assert FEATURES not in read
    os.utime(store.path / FEATURES)
    for _ in range(2):
        _checksum.cache_clear()
        PackedStore.open(store.path)
    assert read.count(FEATURES) == 1
    assert capsys.readouterr().err.count("features.f32") == 1


@pytest.mark.parametrize("stamp", [None, "", "[]", "{}", "[" * 9000])
def test_a_store_without_a_sound_stamp_gets_one(store, stamp):
    (store.path / STAMP).unlink()
    if stamp is not None:
        (store.path / STAMP).write_text(stamp)
    PackedStore.open(store.path)
    assert json.loads((store.path / STAMP).read_text())["size"] == (store.path / FEATURES).stat().st_size


def test_the_doctor_reads_the_features_whatever_their_stamp_says(store):
    assert not [f for f in diagnose(store.path) if f.kind == "unreadable"]
    edit(store.path / FEATURES, 100)
    write_stamp(store.path)
    PackedStore.open(store.path)
    (found,) = (f for f in diagnose(store.path) if f.kind == "unreadable")
    assert "features.f32 was changed" in found.message


BAD = {
    "hash": ["../../x", "0123", 7, None],
    "frames": [-1, 10**12, "many", 1.5, True],
    "skeleton": ["cat", 3],
    "sizes": [{}, [], {"../x": 1}, {"features.f32": "1"}],
    "checksums": [{}, None, {"/etc/passwd": "0"}],
    "fields": [{}, "x"],
    "options": [None, {"request": 3}],
    "format": ["1", None, True],
}


@pytest.mark.parametrize(("key", "value"), [(key, value) for key, values in BAD.items() for value in values])
def test_a_manifest_that_is_wrong_is_named(store, key, value):
    manifest = json.loads((store.path / "manifest.json").read_text())
    (store.path / "manifest.json").write_text(json.dumps(manifest | {key: value}))
    with pytest.raises(ValueError, match=r"manifest\.json "):
        PackedStore.open(store.path)


@pytest.mark.parametrize(
    "content", [b"", b"[]", b"3", b"null", b'"x"', b"{", b"\xff{}", b"[" * 10**5, b'{"a":' * 10**5]
)
def test_a_manifest_that_is_no_object_is_named(store, content):
    (store.path / "manifest.json").write_bytes(content)
    with pytest.raises(ValueError, match=r"^\S*manifest\.json .*; delete the folder and prepare it again$"):
        PackedStore.open(store.path)

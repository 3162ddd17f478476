from __future__ import annotations

import errno
import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from kinema.data import convert, packing
from kinema.data.catalog import Clip, read_joints_folder
from kinema.data.prepare import prepare, prepare_store
from kinema.data.store import PackedStore
from kinema.motion.features import extract
from kinema.motion.mirror import mirror_joints
from kinema.motion.skeleton import HUMANML3D
from kinema.motion.statistics import Statistics


def test_round_trip_of_joints(joints_corpus, tmp_path):
    root = joints_corpus({"a": ("train", 50), "b": ("val", 61, "turn left#turn/VERB left/ADV#0.0#0.0")})
    store = PackedStore.open(prepare_store("joints", root, tmp_path / "out", name="tiny corpus"))
    assert [store.clip_name(c) for c in range(4)] == ["a", "Ma", "b", "Mb"]
    assert store.clips["mirrored"].tolist() == [False, True, False, True]
    joints = np.load(root / "joints" / "b.npy")
    for clip, pose in ((2, joints), (3, mirror_joints(joints, HUMANML3D))):
        wanted = extract(pose, HUMANML3D, target_bone_lengths="skeleton")
        np.testing.assert_array_equal(store.clip_frames(clip), wanted)
    captions = [store.entry_captions(e)[0] for e in store.split_entries("val")]
    assert [c.text for c in captions] == ["turn left", "turn right"]
    assert [c.tokens[1] for c in captions] == ["left/ADV", "right/ADV"]
    assert store.manifest["splits"]["train"] == {
        "clips": 2, "frames": 98, "entries": 2, "entries_without_captions": 0, "captions": 4
    }  # fmt: skip


def test_statistics_are_those_of_all_clips(store):
    wanted = Statistics.compute([np.array(store.features)], store.skeleton)
    np.testing.assert_allclose(store.statistics.mean, wanted.mean, atol=1e-9)
    np.testing.assert_allclose(store.statistics.std, wanted.std, atol=1e-9)


def test_time_tags_make_parts_at_the_corpus_rate(official_corpus, tmp_path):
    text = "whole##0.0#0.0\nfirst##0.0#5.0\nbeyond##4.0#99.0\nshort##0.0#0.5\nbackwards##3.0#1.0\n"
    clips = {"c": ("train", 120, text), "only": ("train", 120, "part##1.0#5.0\n")}
    root = official_corpus(clips, "kit")
    ours = PackedStore.open(prepare_store("official", root, tmp_path / "a", name="kit", skeleton="kit"))
    legacy = prepare_store("official", root, tmp_path / "b", name="kit", skeleton="kit", legacy_fps=True)
    names = ["c", "c#0", "c#1", "only#0"]
    assert [ours.entry_name(e) for e in range(4)] == names
    assert [ours.entry_captions(e)[0].text for e in range(4)] == ["whole", "first", "beyond", "part"]
    assert ours.entries["frames"].tolist() == [120, 62, 70, 50]
    assert PackedStore.open(legacy).entries["frames"].tolist() == [120, 100, 40, 80]
    np.testing.assert_array_equal(ours.frames_of(2), ours.clip_frames(0)[50:])
    assert [(d["name"], d["what"]) for d in ours.dropped] == [("c", "entry")] * 2
    assert "part 2 (0 to 0.5 s) has 6 frames" in ours.dropped[0]["reason"]
    assert ours.manifest["dropped"]["entry"] == 2


@pytest.mark.parametrize(("rows", "kept"), [(39, False), (40, True), (199, True), (200, False)])
def test_length_filter_of_entries_keeps_the_clip(official_corpus, tmp_path, rows, kept):
    out = prepare_store("official", official_corpus({"a": ("train", rows)}), tmp_path / "o", name="x")
    store = PackedStore.open(out)
    assert (store.num_clips, store.num_entries) == (1, int(kept))
    assert store.manifest["dropped"]["entry"] == (not kept)


def test_unusable_clips_are_left_out_with_the_reason(joints_corpus, tmp_path):
    root = joints_corpus(dict.fromkeys(("good", "nan", "bone", "cut", "one", "pickled"), ("train", 50)))
    broken = np.load(root / "joints" / "nan.npy")
    broken[7, 3] = np.nan
    np.save(root / "joints" / "nan.npy", broken)
    collapsed = np.load(root / "joints" / "bone.npy")
    collapsed[:, 4] = collapsed[:, 1]
    np.save(root / "joints" / "bone.npy", collapsed)
    (root / "joints" / "cut.npy").write_bytes((root / "joints" / "cut.npy").read_bytes()[:500])
    np.save(root / "joints" / "one.npy", broken[:1])
    np.save(root / "joints" / "pickled.npy", np.array([{"code": 1}]), allow_pickle=True)
    with pytest.raises(
        ValueError, match=r"5 of 6 clips are unusable, more than the allowed share 0\.2.*--set max_unusable="
    ):
        prepare_store("joints", root, tmp_path / "out", name="x")
    store = PackedStore.open(prepare_store("joints", root, tmp_path / "out", name="x", max_unusable=0.9))
    assert {store.clip_name(c) for c in range(store.num_clips)} == {"good", "Mgood"}
    reasons = {d["name"]: d["reason"] for d in store.dropped}
    assert reasons.keys() == {"nan", "bone", "cut", "one", "pickled"}
    assert "first 7" in reasons["nan"]
    assert "left_knee" in reasons["bone"]
    assert "unreadable" in reasons["cut"]
    assert "unreadable" in reasons["pickled"]
    assert store.manifest["dropped"]["clip"] == 5


def test_nan_in_official_features_is_left_out_of_the_statistics(official_corpus, tmp_path):
    root = official_corpus({"a": ("train", 50), "b": ("train", 50)})
    features = np.load(root / "new_joint_vecs" / "a.npy")
    features[3, 100] = np.inf
    np.save(root / "new_joint_vecs" / "a.npy", features)
    store = PackedStore.open(prepare_store("official", root, tmp_path / "out", name="x", max_unusable=0.5))
    assert np.isfinite(store.statistics.mean).all()
    assert "in 1 frames, first 3" in store.dropped[0]["reason"]


def test_official_clips_are_never_mirrored_again(official_corpus, joints_corpus, tmp_path):
    root = official_corpus({"a": ("train", 50), "Ma": ("train", 50)})
    assert PackedStore.open(prepare_store("official", root, tmp_path / "o", name="x")).num_clips == 2
    with pytest.raises(ValueError, match="cannot be mirrored"):
        prepare_store("official", root, tmp_path / "o", name="x", mirror=True)
    joints = joints_corpus({"a": ("train", 50), "Ma": ("train", 50), "b": ("train", 50)})
    store = PackedStore.open(prepare_store("joints", joints, tmp_path / "o", name="x"))
    assert [store.clip_name(c) for c in range(store.num_clips)] == ["a", "Ma", "b", "Mb"]


def test_folder_statistics_are_used_and_compared(official_corpus, tmp_path):
    root = official_corpus({"a": ("train", 100)})
    mean, std = np.full(263, 0.5), np.full(263, 0.1)
    np.save(root / "Mean.npy", mean)
    np.save(root / "Std.npy", std)
    store = PackedStore.open(prepare_store("official", root, tmp_path / "o", name="x"))
    np.testing.assert_array_equal(store.statistics.mean, mean)
    found = store.manifest["statistics"]
    assert found["source"] == "folder"
    assert found["mean_deviation"] > 0.4
    assert found["std_ratio"][1] < 0.2
    np.save(root / "Std.npy", std * 2)
    assert PackedStore.open(prepare_store("official", root, tmp_path / "o", name="x")).hash != store.hash


@pytest.mark.parametrize("width", [67, 251])
def test_wrong_width_is_refused_and_named(official_corpus, tmp_path, width):
    root = official_corpus({"a": ("train", 50)})
    np.save(root / "new_joint_vecs" / "a.npy", np.zeros((50, width), np.float32))
    with pytest.raises(ValueError, match=rf"'a': .* shape \(50, {width}\); humanml3d needs \(frames, 263\)"):
        prepare_store("official", root, tmp_path / "o", name="x")
    assert not [p for p in (tmp_path / "o").iterdir() if p.is_dir()]


def test_wrong_skeleton_is_refused(joints_corpus, tmp_path):
    root = joints_corpus({"a": ("train", 50)})
    with pytest.raises(ValueError, match=r"kit needs \(frames, 21, 3\)"):
        prepare_store("joints", root, tmp_path / "o", name="x", skeleton="kit")


def test_kit_joints_keep_their_bone_lengths(joints_corpus, tmp_path):
    root = joints_corpus({"a": ("train", 50)}, skeleton="kit")
    store = PackedStore.open(prepare_store("joints", root, tmp_path / "o", name="x", skeleton="kit"))
    assert store.features.shape == (98, 251)


def test_too_many_missing_clips_are_an_error(joints_corpus, tmp_path):
    root = joints_corpus(dict.fromkeys("abcd", ("train", 50)))
    (root / "joints" / "a.npy").unlink()
    with pytest.raises(ValueError, match=r"1 of 4 listed clips .* 0\.05 .*joints/a\.npy not found"):
        prepare_store("joints", root, tmp_path / "o", name="x")
    store = PackedStore.open(prepare_store("joints", root, tmp_path / "o", name="x", max_missing=0.25))
    assert store.manifest["dropped"]["missing"] == 1
    assert store.dropped[0]["name"] == "a"


def test_nothing_usable_is_an_error(joints_corpus, tmp_path):
    root = joints_corpus({"a": ("train", 1)})
    with pytest.raises(ValueError, match=r"no usable clip.*1 frames"):
        prepare_store("joints", root, tmp_path / "o", name="x")


def test_the_same_request_is_answered_at_once(joints_corpus, tmp_path, monkeypatch):
    root = joints_corpus({"a": ("train", 50)})
    first = prepare_store("joints", root, tmp_path / "o", name="x")
    with monkeypatch.context() as patch:
        patch.setattr("kinema.data.prepare.convert", None)  # any work would fail
        assert prepare_store("joints", root, tmp_path / "o", name="x") == first
    assert prepare_store("joints", root, tmp_path / "o", name="x", mirror=False) != first
    np.save(root / "joints" / "a.npy", np.load(root / "joints" / "a.npy")[:-1])
    assert prepare_store("joints", root, tmp_path / "o", name="x") != first


def test_content_hash_knows_content_only(joints_corpus, tmp_path):
    clips = {"a": ("train", 50), "b": ("test", 50)}
    roots = [joints_corpus(clips, folder=f) for f in ("one", "two")]
    hashes = {PackedStore.open(prepare_store("joints", r, tmp_path / "o", name=r.name)).hash for r in roots}
    assert len(hashes) == 1
    (roots[1] / "texts" / "a.txt").write_text("something else\n")
    assert PackedStore.open(prepare_store("joints", roots[1], tmp_path / "o", name="two")).hash not in hashes


@pytest.mark.parametrize("reader", ["joints", "synthetic"])
def test_a_corpus_is_the_same_on_a_machine_that_rounds_otherwise(reader, joints_corpus, tmp_path, monkeypatch):
    source, options = (joints_corpus({"a": ("train", 50)}), {}) if reader == "joints" else (None, {"size": 10})
    first = PackedStore.open(prepare_store(reader, source, tmp_path / "one", name="x", **options))
    extract = convert.extract
    monkeypatch.setattr(convert, "extract", lambda *a, **k: np.nextafter(extract(*a, **k), np.float32(np.inf)))
    other = PackedStore.open(prepare_store(reader, source, tmp_path / "two", name="x", **options))
    assert other.manifest["checksums"]["features.f32"] != first.manifest["checksums"]["features.f32"]
    assert other.hash == first.hash
    # Another extraction of features is another corpus, and stores made before are not taken for it.
    monkeypatch.setattr("kinema.data.packing.FEATURES", convert.VERSION + 1)
    monkeypatch.setattr("kinema.data.prepare.FEATURES", convert.VERSION + 1)
    later = PackedStore.open(prepare_store(reader, source, tmp_path / "one", name="x", **options))
    assert later.path != first.path
    assert later.hash != first.hash


def test_several_processes_give_the_same_store(joints_corpus, tmp_path):
    catalog = read_joints_folder(joints_corpus(dict.fromkeys("abc", ("train", 45))))
    one, two = (PackedStore.open(prepare(catalog, tmp_path / str(n), name="x", processes=n)) for n in (1, 2))
    assert one.manifest["checksums"] == two.manifest["checksums"]


def test_two_that_prepare_at_once_share_the_work(joints_corpus, tmp_path):
    ask = partial(prepare_store, "joints", joints_corpus({"a": ("train", 50)}), tmp_path / "o", name="x")
    with ThreadPoolExecutor(2) as pool:
        first, second = (job.result() for job in [pool.submit(ask), pool.submit(ask)])
    assert first == second
    assert [p.name for p in (tmp_path / "o").iterdir() if p.is_dir()] == [first.name]


def test_full_disk_leaves_nothing_and_says_how_much_is_needed(joints_corpus, tmp_path, monkeypatch):
    def fail(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(packing.StoreWriter, "add", fail)
    with pytest.raises(OSError, match=r"needs about \d+\.\d+ GB.*nothing was kept") as caught:
        prepare_store("joints", joints_corpus({"a": ("train", 50)}), tmp_path / "o", name="x")
    assert caught.value.errno == errno.ENOSPC
    assert not [p for p in (tmp_path / "o").iterdir() if p.is_dir()]


def test_remains_of_a_killed_process_are_replaced(joints_corpus, tmp_path):
    catalog = read_joints_folder(joints_corpus({"a": ("train", 50)}))
    (tmp_path / ".out-partial").mkdir()
    (tmp_path / ".out-partial" / "features.f32").write_bytes(b"half")
    PackedStore.open(prepare(catalog, tmp_path / "out", name="x")).verify()
    assert not (tmp_path / ".out-partial").exists()


def test_the_same_motion_of_which_something_else_is_known_takes_its_place(joints_corpus, tmp_path):
    catalog = read_joints_folder(joints_corpus({"a": ("train", 50)}))
    labelled = [replace(clip, fields={"style": style}) for style in ("old", "young") for clip in catalog]
    out = prepare(labelled[:1], tmp_path / "out", name="x")
    first = PackedStore.open(out)
    prepare(labelled[1:], out, name="x")
    second = PackedStore.open(out)
    second.verify()
    assert second.hash == first.hash  # what was trained on the one is a model of the other
    assert [store.manifest["checksums"] == second.manifest["checksums"] for store in (first, second)] == [False, True]
    assert second.clip_field(0, "style") == "young"
    assert [path.name for path in tmp_path.iterdir() if "partial" in path.name] == []


def test_another_corpus_is_not_overwritten(joints_corpus, tmp_path):
    catalog = read_joints_folder(joints_corpus({"a": ("train", 50)}))
    out = prepare(catalog, tmp_path / "out", name="x")
    assert prepare(catalog, out, name="x") == out
    with pytest.raises(ValueError, match="another content"):
        prepare(catalog, out, name="x", mirror=False)
    (tmp_path / "mine").mkdir()
    with pytest.raises(ValueError, match="no packed corpus"):
        prepare(catalog, tmp_path / "mine", name="x")


def test_clips_of_a_user_need_no_files(tmp_path):
    features = np.random.default_rng(0).normal(size=(50, 263))
    clip = Clip("mine", "train", fields={"licence": "CC0"}, features=lambda: features)
    store = PackedStore.open(prepare([clip], tmp_path / "out", name="x", mirror=False))
    np.testing.assert_array_equal(store.clip_frames(0), features.astype(np.float32))
    assert store.clip_field(0, "licence") == "CC0"
    assert store.manifest["splits"]["train"]["entries_without_captions"] == 1


def test_unknown_reader_is_named(tmp_path):
    with pytest.raises(ValueError, match="unknown reader 'zip'; choose one of joints, captures, official"):
        prepare_store("zip", tmp_path, tmp_path, name="x")


def test_manifest_is_small_whatever_the_corpus(store):
    assert len(json.dumps(store.manifest)) < 4000

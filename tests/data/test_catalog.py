from __future__ import annotations

import json

import numpy as np
import pytest

from kinema import cli
from kinema.data.catalog import Clip, read_joints_folder, read_official
from kinema.data.doctor import diagnose, format


def test_clips_come_in_split_order_with_captions_and_fields(joints_corpus):
    root = joints_corpus({"b": ("test", 50), "a": ("train", 60), "c": ("train", 70)})
    (root / "manifest.json").write_text(json.dumps([{"name": "a", "source": "cmu", "frames": 60, "split": "train"}]))
    catalog = read_joints_folder(root)
    assert [(c.name, c.split) for c in catalog] == [("a", "train"), ("c", "train"), ("b", "test")]
    assert [c.caption.text for c in catalog.clips[0].captions] == ["a person walks left", "they jump"]
    assert [c.fields for c in catalog] == [{"source": "cmu"}, {}, {}]
    assert catalog.clips[0].joints().shape == (60, 22, 3)


def test_files_that_lack_are_dropped_with_the_reason(joints_corpus):
    root = joints_corpus(dict.fromkeys("abc", ("train", 50)))
    (root / "joints" / "a.npy").unlink()
    (root / "texts" / "b.txt").unlink()
    catalog = read_joints_folder(root)
    assert [c.name for c in catalog] == ["c"]
    reasons = {d.name: (d.what, d.reason) for d in catalog.dropped}
    assert reasons == {"a": ("missing", "joints/a.npy not found"), "b": ("missing", "texts/b.txt not found")}


def test_a_file_that_lies_there_under_another_name_is_named_with_the_fix(joints_corpus, official_corpus):
    root = joints_corpus(dict.fromkeys(("a", "b", "more"), ("train", 50)))
    (root / "joints/a.npy").rename(root / "joints/a.NPY")
    np.savez(root / "joints/b.npz", joints=np.load(root / "joints/b.npy"))
    (root / "joints/b.npy").unlink()
    (root / "texts/b.txt").rename(root / "texts/b.TXT")
    assert {d.name: d.reason for d in read_joints_folder(root).dropped} == {
        "a": "joints/a.npy not found, but joints/a.NPY is there: rename it",
        "b": "joints/b.npy and texts/b.txt not found, but joints/b.npz is there: kinema export joints/b.npz --out "
        "joints/b.npy, but texts/b.TXT is there: rename it",
    }
    (root / "joints/more.npy").unlink()
    assert "has no joints/*.npy, but joints/a.NPY is there: rename it" in format(diagnose(root))
    assert cli.main(["export", str(root / "joints/b.npz"), "--out", str(root / "joints/b.npy")]) == 0
    assert np.load(root / "joints/b.npy").shape == (50, 22, 3)
    features = official_corpus({"a": ("train", 50)})
    np.savez(features / "new_joint_vecs/a.npz", np.load(features / "new_joint_vecs/a.npy"))
    (features / "new_joint_vecs/a.npy").unlink()
    (dropped,) = read_official(features).dropped
    assert dropped.reason.endswith("but new_joint_vecs/a.npz is there: save its array as .npy")


def test_unreadable_caption_lines_are_named(joints_corpus):
    catalog = read_joints_folder(joints_corpus({"a": ("train", 50, "fine\nbad##x#y\n")}))
    assert len(catalog.clips[0].captions) == 1
    (dropped,) = catalog.dropped
    assert dropped.what == "caption"
    assert "line 2" in dropped.reason


def test_a_corpus_may_have_no_texts(joints_corpus):
    catalog = read_joints_folder(joints_corpus({"a": ("train", 50, None)}))
    assert [c.captions for c in catalog] == [[]]
    assert not catalog.dropped


def test_names_with_spaces_dots_and_windows_line_ends(joints_corpus):
    root = joints_corpus({"a b.c": ("train", 50)})
    (root / "train.txt").write_bytes(b"\xef\xbb\xbfa b.c\r\n\r\n")
    assert [c.name for c in read_joints_folder(root)] == ["a b.c"]


def test_missing_split_file_is_named_with_the_layout(joints_corpus):
    root = joints_corpus({"a": ("train", 50)})
    (root / "val.txt").unlink()
    with pytest.raises(FileNotFoundError, match=r"lacks val\.txt; expected layout: joints/NAME\.npy"):
        read_joints_folder(root)
    with pytest.raises(FileNotFoundError, match="does not exist"):
        read_joints_folder(root / "nowhere")
    with pytest.raises(FileNotFoundError, match="lacks new_joint_vecs"):
        read_official(root)


@pytest.mark.parametrize(("again", "says"), [("train", "twice in train"), ("test", "train.txt and test.txt")])
def test_a_clip_listed_twice_is_refused(joints_corpus, again, says):
    root = joints_corpus({"a": ("train", 50)})
    with (root / f"{again}.txt").open("a") as file:
        file.write("a\n")
    with pytest.raises(ValueError, match=says):
        read_joints_folder(root)


def test_a_folder_may_hold_further_splits(joints_corpus):
    root = joints_corpus({"a": ("train", 50), "b": ("val", 50), "c": ("test", 50)})
    (root / "other").mkdir()
    for part, name in (("train", "c"), ("val", "a"), ("test", "b")):
        (root / "other" / f"{part}.txt").write_text(name)
    assert [(c.name, c.split) for c in read_joints_folder(root)] == [("a", "train"), ("b", "val"), ("c", "test")]
    other = read_joints_folder(root, split="other")
    assert [(c.name, c.split) for c in other] == [("c", "train"), ("a", "val"), ("b", "test")]
    with pytest.raises(FileNotFoundError, match=r"lacks new/train.txt, new/val.txt, new/test.txt"):
        read_joints_folder(root, split="new")


def test_official_folder_knows_its_mirrored_clips_and_statistics(official_corpus):
    root = official_corpus({"000001": ("train", 50), "M000001": ("train", 50), "Mimic": ("val", 50)})
    assert read_official(root).statistics is None
    np.save(root / "Mean.npy", np.zeros(263))
    with pytest.raises(FileNotFoundError, match="not its twin"):
        read_official(root)
    np.save(root / "Std.npy", np.ones(263))
    catalog = read_official(root)
    assert [c.mirrored for c in catalog] == [False, True, False]
    assert catalog.statistics.mean.shape == (263,)
    with pytest.raises(ValueError, match="263 wide, kit has 251"):
        read_official(root, "kit")


def test_clip_refuses_unknown_splits_and_two_motions():
    with pytest.raises(ValueError, match="'dev'"):
        Clip("a", "dev", joints=lambda: None)
    with pytest.raises(ValueError, match="either"):
        Clip("a", "train")

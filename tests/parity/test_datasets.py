"""Compare with what the published data sets make of nine clips (golden/mardm/mardm_datasets)."""

from __future__ import annotations

import json

import numpy as np
import pytest
from safetensors.numpy import load_file

from kinema.data.datasets import ClipDataset, WindowDataset
from kinema.data.prepare import prepare_store
from kinema.data.store import PackedStore
from kinema.motion.skeleton import get_skeleton

WALK = "a person walks left#a/DET person/NOUN walk/VERB left/ADV#0.0#0.0\nthey jump#they/PRON jump/VERB#nan#nan\n"
TEXTS = {
    "000005": "middle#middle/NOUN#1.0#4.5\n",
    "000006": "first part#first/ADJ part/NOUN#0.0#3.0\nwhole#whole/NOUN#0.0#0.0\n",
}


@pytest.fixture(scope="module")
def golden(golden_file):
    facts = json.loads(golden_file("mardm/mardm_datasets.json").read_text())
    return facts, load_file(golden_file("mardm/mardm_datasets.safetensors"))


def make_store(golden, folder, skeleton, change=None):
    """Pack the nine clips; `change` gives the first frames of some."""
    width = get_skeleton(skeleton).feature_width
    (folder / "new_joint_vecs").mkdir(parents=True)
    (folder / "texts").mkdir()
    for seed, (name, frames) in enumerate(golden[0]["clip_lengths"].items()):
        features = np.random.default_rng(seed).normal(size=(frames, width)).astype(np.float32)
        start, rows = (change or {}).get(name, (0, features[:0]))
        features[start : start + len(rows), : rows.shape[1]] = rows
        np.save(folder / "new_joint_vecs" / f"{name}.npy", features)
        (folder / "texts" / f"{name}.txt").write_text(TEXTS.get(name, WALK))
    (folder / "train.txt").write_text("\n".join(golden[0]["clip_lengths"]))
    for split in ("val", "test"):
        (folder / f"{split}.txt").write_text("")
    out = prepare_store("official", folder, folder / "out", name="nine", skeleton=skeleton, legacy_fps=True)
    return PackedStore.open(out)


@pytest.mark.parametrize(("skeleton", "key"), [("humanml3d", "t2m"), ("kit", "kit")])
def test_kept_clips_and_parts(golden, tmp_path, skeleton, key):
    store = make_store(golden, tmp_path / "c", skeleton)
    ours = [
        {
            "clip": store.clip_name(row["clip"]),
            "subclip": bool(row["part"] >= 0),
            "length": int(row["frames"]),
            "captions": [c.text for c in store.entry_captions(e)],
        }
        for e, row in enumerate(store.entries)
    ]
    by_name = lambda e: (e["clip"], e["subclip"])  # noqa: E731
    assert sorted(ours, key=by_name) == sorted(golden[0][key], key=by_name)


def test_published_window_space(golden, tmp_path):
    store = make_store(golden, tmp_path / "c", "humanml3d")
    data = WindowDataset(store, "train", 64, legacy=True)
    assert len(data) == golden[0]["ae_len"]
    assert [store.clip_name(c) for c in data.clips] == golden[0]["ae_clips_kept"]
    assert [list(data.locate(i)) for i in range(len(data))] == golden[1]["out.ae_clip_and_start"].tolist()
    assert len(WindowDataset(store, "train", 64)) == len(data) + len(data.clips)


def test_evaluation_items(golden, tmp_path):
    """Given the golden's draws (caption, length, a start), the item holds the golden's frames, length and tokens."""
    facts, arrays = golden
    mean, std = arrays["in.mean"], arrays["in.std"]
    for number, (wanted, clip) in enumerate(zip(facts["eval_items"], facts["eval_order"], strict=True)):
        motion, frames = arrays[f"out.eval_item{number}.motion"], wanted["m_length"]
        assert not motion[frames:].any()
        part_start = 20 if clip == "000005" else 0
        change = {clip: (part_start, (motion[:frames] * std + mean).astype(np.float32))}
        store = make_store(golden, tmp_path / str(number), "humanml3d", change)
        data = ClipDataset(store, "train")
        item = find(data, store, clip, wanted["caption"], frames)
        padded = np.zeros_like(motion)
        padded[:frames] = (item.features[:, :67] - mean) / std
        np.testing.assert_allclose(padded, motion, rtol=1e-4, atol=1e-5)
        tokens = wanted["tokens"].split("_")
        assert list(item.caption.tokens) == tokens[1 : tokens.index("eos/OTHER")]
        assert len(item.caption.tokens) + 2 == wanted["sent_len"]


def find(data, store, clip, caption, frames):
    """Draw until the golden's caption and length come from the clip's entry, starting at its first frame."""
    for index, entry in enumerate(data.entries):
        if store.clip_name(store.entries[entry]["clip"]) != clip:
            continue
        for seed in range(300):
            item = data[index, seed]
            if (item.caption.text, item.start, len(item.features)) == (caption, 0, frames):
                return item
    raise AssertionError(f"{clip}: no draw gives {caption!r} with {frames} frames")

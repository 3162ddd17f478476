"""Make small corpora: bodies that drift and wobble, so that every feature column has a value."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from kinema.data.prepare import prepare_store
from kinema.data.store import PackedStore
from kinema.motion.skeleton import get_skeleton

Corpus = Callable[..., Path]


def drifting_body(frames: int, skeleton: str = "humanml3d", seed: int = 0) -> np.ndarray:
    """Make joints (frames, J, 3) of a body that drifts ahead and wobbles smoothly."""
    body, draw = get_skeleton(skeleton), np.random.default_rng(seed)
    lengths = np.full(body.num_joints, 100.0) if body.bone_lengths is None else body.bone_lengths
    pose, sides = np.zeros((body.num_joints, 3)), (1 if body.unit == "m" else -1, 1, 1)  # KIT's rest is a mirror image
    for chain in body.chains:
        for parent, child in pairwise(chain):
            pose[child] = pose[parent] + lengths[child] * body.rest_directions[child] * sides
    time = np.arange(frames)[:, None, None] / 20
    size = lengths[1:].mean()
    wobble = np.sin(time * draw.uniform(1, 4, pose.shape) + draw.uniform(0, 6, pose.shape)) * size * 0.1
    drift = time * draw.uniform(-1, 1, 3) * (size, 0, size)
    return (pose + wobble + drift).astype(np.float32)


TEXT = "a person walks left#a/DET person/NOUN walk/VERB left/ADV#0.0#0.0\nthey jump#they/PRON jump/VERB#0.0#0.0\n"


@pytest.fixture
def joints_corpus(tmp_path: Path) -> Corpus:
    """Give a function that writes a joints folder: `{name: (split, frames[, text or None])}`."""

    def write(clips: dict[str, tuple], skeleton: str = "humanml3d", folder: str = "source") -> Path:
        root = tmp_path / folder
        (root / "joints").mkdir(parents=True)
        for seed, (name, (_, frames, *text)) in enumerate(clips.items()):
            np.save(root / "joints" / f"{name}.npy", drifting_body(frames, skeleton, seed))
            if text != [None]:
                (root / "texts").mkdir(exist_ok=True)
                (root / "texts" / f"{name}.txt").write_text("".join(text) or TEXT, encoding="utf-8")
        write_splits(root, {name: split for name, (split, *_) in clips.items()})
        return root

    return write


@pytest.fixture
def official_corpus(tmp_path: Path) -> Corpus:
    """Give a function that writes an official folder of noise: `{name: (split, frames[, text])}`."""

    def write(clips: dict[str, tuple], skeleton: str = "humanml3d", folder: str = "official") -> Path:
        root, width = tmp_path / folder, get_skeleton(skeleton).feature_width
        for sub in ("new_joint_vecs", "texts"):
            (root / sub).mkdir(parents=True)
        for seed, (name, (_, frames, *text)) in enumerate(clips.items()):
            features = np.random.default_rng(seed).normal(size=(frames, width)).astype(np.float32)
            np.save(root / "new_joint_vecs" / f"{name}.npy", features)
            (root / "texts" / f"{name}.txt").write_text("".join(text) or TEXT, encoding="utf-8")
        write_splits(root, {name: split for name, (split, *_) in clips.items()})
        return root

    return write


def write_splits(root: Path, splits: dict[str, str]) -> None:
    """Write train.txt, val.txt and test.txt."""
    for split in ("train", "val", "test"):
        names = [name for name, where in splits.items() if where == split]
        (root / f"{split}.txt").write_text("".join(f"{name}\n" for name in names))


@pytest.fixture
def store(joints_corpus: Corpus, tmp_path: Path) -> PackedStore:
    """Give a packed corpus of 12 training, 5 validation and 7 test clips, mirrored, 60 to 115 frames of features."""
    counts = {"train": 12, "val": 5, "test": 7}
    clips = {f"{s}{i}": (s, 61 + 5 * i) for s, n in counts.items() for i in range(n)}
    return PackedStore.open(prepare_store("joints", joints_corpus(clips), tmp_path / "stores", name="tiny"))

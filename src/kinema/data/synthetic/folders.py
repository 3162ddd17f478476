"""Write clips in the layouts that the readers read."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from kinema.atomic import new_folder
from kinema.data.captions import AnnotatedCaption
from kinema.data.catalog import SPLITS, Clip
from kinema.motion.features import extract
from kinema.motion.mirror import mirror_joints
from kinema.motion.skeleton import get_skeleton
from kinema.motion.statistics import Statistics


def format_caption(annotated: AnnotatedCaption) -> str:
    """Write one line of a caption file: `caption#word/POS ...#start#end`."""
    caption = annotated.caption
    return f"{caption.text}#{' '.join(caption.tokens)}#{annotated.start}#{annotated.end}"


def write_joints_folder(clips: Iterable[Clip], path: str | Path) -> Path:
    """Write clips of joints as `joints/`, `texts/`, split files and `manifest.json` (the clips' fields)."""
    names: dict[str, list[str]] = {split: [] for split in SPLITS}
    rows = []
    with new_folder(path) as root:
        for clip in clips:
            joints = _loader(clip)()
            _write(root, "joints", clip.name, joints, clip.captions)
            names[clip.split].append(clip.name)
            rows.append({"name": clip.name, **clip.fields, "frames": len(joints), "split": clip.split})
        _write_splits(root, names)
        (root / "manifest.json").write_text(json.dumps(rows, indent=0), encoding="utf-8")
    return Path(path)


def write_official_folder(clips: Iterable[Clip], path: str | Path, skeleton: str = "humanml3d") -> Path:
    """Write clips of joints as HumanML3D and KIT-ML are laid out, mirrored clips (`MNAME`) and statistics included."""
    names: dict[str, list[str]] = {split: [] for split in SPLITS}
    kind, rows = get_skeleton(skeleton), []
    target = None if kind.bone_lengths is None else "skeleton"
    with new_folder(path) as root:
        for clip in clips:
            joints = _loader(clip)()
            for name, motion, captions in (
                (clip.name, joints, clip.captions),
                (f"M{clip.name}", mirror_joints(joints, kind), [c.mirrored() for c in clip.captions]),
            ):
                features = extract(motion, kind, target_bone_lengths=target)
                _write(root, "new_joint_vecs", name, features, captions)
                names[clip.split].append(name)
                rows.append(features)
        _write_splits(root, names)
        statistics = Statistics.compute(rows, kind)
        np.save(root / "Mean.npy", statistics.mean.astype(np.float32))
        np.save(root / "Std.npy", statistics.std.astype(np.float32))
    return Path(path)


def _loader(clip: Clip) -> Callable[[], np.ndarray]:
    if clip.joints is None:
        raise ValueError(f"clip {clip.name!r} holds features; only clips of joints can be written")
    return clip.joints


def _write(root: Path, folder: str, name: str, motion: np.ndarray, captions: list[AnnotatedCaption]) -> None:
    for part in (folder, "texts"):
        (root / part).mkdir(parents=True, exist_ok=True)
    np.save(root / folder / f"{name}.npy", motion)
    lines = [format_caption(c) + "\n" for c in captions]
    (root / "texts" / f"{name}.txt").write_text("".join(lines), encoding="utf-8")


def _write_splits(root: Path, names: dict[str, list[str]]) -> None:
    for split, listed in names.items():
        (root / f"{split}.txt").write_text("".join(f"{name}\n" for name in listed), encoding="utf-8")
    (root / "all.txt").write_text("".join(f"{n}\n" for split in SPLITS for n in names[split]), encoding="utf-8")

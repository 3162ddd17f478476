"""Turn one clip's arrays into features, or say why it is unusable."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from kinema.data.catalog import Clip, Dropped
from kinema.motion.checks import check_clip
from kinema.motion.features import extract
from kinema.motion.mirror import mirror_joints
from kinema.motion.shapes import ForeignShapeError
from kinema.motion.skeleton import Skeleton, get_skeleton

VERSION = 1
"""Raised when the same motion gives other features: corpora made of it are then others."""

WRITE, OR_NOT = "write joints as the message says", ", or take the clips off the lists"


@dataclass(frozen=True)
class Converted:
    """Hold a clip's features, those of its mirror image (or nothing), and the hash of what they were made from.

    Two kinds of CPU make features of the same motion that differ in the last bit, so that these can't name a corpus;
    the motion itself is read, brought to the skeleton's rate and turned without rounding that depends on the machine.
    """

    features: np.ndarray
    mirrored: np.ndarray | None
    digest: bytes


def convert(job: tuple[Clip, str, bool]) -> Dropped | Converted:
    """Load a clip (clip, skeleton name, mirror too?); give its features and its mirror image's, or why it has none."""
    clip, name, mirror = job
    skeleton = get_skeleton(name)
    load = clip.features or clip.joints
    assert load is not None  # a clip has one of the two
    try:
        array = load()
    except (OSError, ValueError) as error:
        return _dropped(clip, f"unreadable: {error}", "", "")
    if clip.features is not None:
        return _checked_features(clip, array, skeleton)
    try:
        joints = clip.convention.apply(array, skeleton)
    except ForeignShapeError as error:
        return _dropped(clip, str(error), "shape", f"{error.fix or WRITE}{OR_NOT}")
    except ValueError as error:
        return _dropped(clip, str(error), "shape", f"{WRITE}{OR_NOT}")
    for problem in check_clip(joints, skeleton, skeleton.fps, clip.convention):
        if problem.fatal:
            return _dropped(clip, problem.message, problem.kind, problem.fix)
    lengths = None if skeleton.bone_lengths is None else "skeleton"
    poses = [joints, mirror_joints(joints, skeleton)] if mirror else [joints]
    rows, *image = (extract(pose, skeleton, target_bone_lengths=lengths) for pose in poses)
    made_from = clip.made_from.encode() or _content(joints)
    return Converted(rows, image[0] if image else None, hashlib.sha256(made_from).digest())


def _content(array: np.ndarray) -> bytes:
    return f"{array.dtype.str} {array.shape} ".encode() + np.ascontiguousarray(array).tobytes()


def _dropped(clip: Clip, reason: str, kind: str, fix: str) -> Dropped:
    return Dropped(clip.name, clip.split, "clip", reason, kind, fix)


def _checked_features(clip: Clip, array: np.ndarray, skeleton: Skeleton) -> Dropped | Converted:
    if array.ndim != 2 or array.shape[1] != skeleton.feature_width:
        needed = f"{skeleton.name} needs (frames, {skeleton.feature_width}), the full width"
        reason = (
            f"features have shape {array.shape}; {needed}: `representation` selects the essential part at training time"
        )
        if array.ndim == 3:
            reason = (
                f"features have shape {array.shape}; {needed}: these are joints, for a joints folder (--format joints)"
            )
        return _dropped(clip, reason, "shape", "take the folder of the full features (new_joint_vecs) of this skeleton")
    if len(array) == 0:
        return _dropped(clip, "no frames", "", "")
    bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
    if len(bad):
        return _dropped(clip, f"NaN or infinite values in {len(bad)} frames, first {bad[0]}", "nan", "extract it again")
    return Converted(array, None, hashlib.sha256(_content(array.astype("<f4"))).digest())

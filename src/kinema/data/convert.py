"""Turn one clip's arrays into features, or say why it is unusable."""

from __future__ import annotations

import numpy as np

from kinema.data.catalog import Clip, Dropped
from kinema.motion.checks import check_clip
from kinema.motion.features import extract
from kinema.motion.mirror import mirror_joints
from kinema.motion.skeleton import Skeleton, get_skeleton

FATAL = ("nan", "bone")
"""Problems that leave a clip without features. A jump does not; `kinema doctor` shows it."""


def convert(job: tuple[Clip, str, bool]) -> Dropped | list[np.ndarray]:
    """Load a clip (clip, skeleton name, mirror too?); give its features and its mirror image's, or why it has none.

    Raises ValueError for an array of the wrong shape: then the whole corpus is not what it was taken for.
    """
    clip, name, mirror = job
    skeleton = get_skeleton(name)
    load = clip.features or clip.joints
    assert load is not None  # a clip has one of the two
    try:
        array = load()
    except (OSError, ValueError) as error:
        return Dropped(clip.name, clip.split, "clip", f"unreadable: {error}")
    if clip.features is not None:
        return _checked_features(clip, array, skeleton)
    if array.ndim != 3 or array.shape[1:] != (skeleton.num_joints, 3):
        raise ValueError(
            f"clip {clip.name!r} has joints of shape {array.shape}; {name} needs (frames, {skeleton.num_joints}, 3), "
            "joints in the order of kinema.motion.skeleton"
        )
    if len(array) < 2:
        return Dropped(clip.name, clip.split, "clip", f"{len(array)} frames; features need at least 2")
    problems = [p for p in check_clip(array, skeleton, skeleton.fps) if p.kind in FATAL]
    if problems:
        return Dropped(clip.name, clip.split, "clip", problems[0].message)
    poses = [array, mirror_joints(array, skeleton)] if mirror else [array]
    lengths = None if skeleton.bone_lengths is None else "skeleton"
    return [extract(pose, skeleton, target_bone_lengths=lengths) for pose in poses]


def _checked_features(clip: Clip, array: np.ndarray, skeleton: Skeleton) -> Dropped | list[np.ndarray]:
    if array.ndim != 2 or array.shape[1] != skeleton.feature_width:
        raise ValueError(
            f"clip {clip.name!r} has features of shape {array.shape}; {skeleton.name} needs (frames, "
            f"{skeleton.feature_width}), the full width: `representation` selects the essential part at training time"
        )
    if len(array) == 0:
        return Dropped(clip.name, clip.split, "clip", "no frames")
    bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
    if len(bad):
        return Dropped(clip.name, clip.split, "clip", f"NaN or infinite values in {len(bad)} frames, first {bad[0]}")
    return [array]

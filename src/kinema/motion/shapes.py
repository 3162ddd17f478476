"""Tell from an array's shape what motion it holds, or say in one line how to make motion of it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Shaped

from kinema.motion.skeleton import HUMANML3D, SKELETONS, Skeleton

SMPL_FAMILY = {24: "SMPL", 52: "SMPL-H, as AMASS has it", 55: "SMPL-X", 127: "SMPL-X with its face"}
"""Numbers of joints of the bodies whose first 22 joints are HumanML3D's."""


class ForeignShapeError(ValueError):
    """An array holds no joints of a skeleton; `fix` says what makes some of it, if anything does."""

    def __init__(self, shape: tuple[int, ...], skeleton: Skeleton) -> None:
        super().__init__(f"joints have shape {shape}; {explain(shape, skeleton)}")
        self.fix = _kind(shape, [skeleton])[1]


def skeleton_of(array: np.ndarray) -> Skeleton:
    """Tell the skeleton of joints (T, J, 3) or features (T, D). Raises ValueError that says what the array is."""
    for skeleton in SKELETONS.values():
        joints = array.ndim == 3 and array.shape[2] == 3 and array.shape[1] in joint_counts(skeleton)
        if joints or is_features(array, skeleton):
            return skeleton
    raise ValueError(explain(array.shape))


def joint_counts(skeleton: Skeleton) -> tuple[int, ...]:
    """List how many joints an array may have of which the first are the skeleton's."""
    return (skeleton.num_joints, *(SMPL_FAMILY if skeleton is HUMANML3D else ()))


def is_features(array: np.ndarray, skeleton: Skeleton) -> bool:
    """Tell whether an array holds a skeleton's feature rows, the full ones or the essential."""
    return array.ndim == 2 and array.shape[1] in (skeleton.feature_width, skeleton.essential_width)


def as_joints(array: np.ndarray, skeleton: Skeleton) -> Shaped[np.ndarray, "t j 3"]:
    """Return the skeleton's joints, the first of a body that has hands too. Raises ForeignShapeError."""
    if array.ndim == 3 and array.shape[2] == 3 and array.shape[1] in joint_counts(skeleton):
        return array[:, : skeleton.num_joints]
    raise ForeignShapeError(array.shape, skeleton)


def explain(shape: tuple[int, ...], skeleton: Skeleton | None = None) -> str:
    """Say what an array of a wrong shape is and what is needed: of `skeleton`, or of any."""
    skeletons = [skeleton] if skeleton is not None else list(SKELETONS.values())
    needed = " or ".join(f"{s.name} needs (frames, {s.num_joints}, 3)" for s in skeletons)
    found = ": ".join(part for part in _kind(shape, skeletons) if part)
    return f"{found}; {needed}, joints in the order of kinema.motion.skeleton"


def _kind(shape: tuple[int, ...], skeletons: list[Skeleton]) -> tuple[str, str]:
    """Say what an array is, and how motion is made of it."""
    if len(shape) == 2:
        return _kind_of_rows(shape, skeletons)
    for joints in (s.num_joints for s in skeletons):
        if len(shape) == 4 and shape[2:] == (joints, 3):
            return f"this is a batch of {shape[0]} clips", "save each of them as a file (motions[i])"
        if len(shape) == 4 and shape[1:3] == (joints, 3):
            return f"this is a batch of {shape[0]} clips with time last", "save motions[i].transpose(2, 0, 1)"
        if len(shape) == 3 and shape[:2] == (joints, 3):
            return "time comes last", "save joints.transpose(2, 0, 1)"
        if len(shape) == 3 and shape[1:] == (3, joints):
            return "joints come last", "save joints.transpose(0, 2, 1)"
    if len(shape) == 3 and shape[2] == 3:
        return f"this is a body of {shape[1]} joints, which no order makes one of these", ""
    return "this is no motion", ""


def _kind_of_rows(shape: tuple[int, ...], skeletons: list[Skeleton]) -> tuple[str, str]:
    frames, width = shape
    for known in SKELETONS.values():
        if width in (known.feature_width, known.essential_width):
            fix = f"they go into new_joint_vecs/ (--format {known.name})"
            return f"these are {known.name}'s features, not joints", fix
    for joints in (s.num_joints for s in skeletons):
        if shape == (joints, 3):
            return "this is a single frame, squeezed when it was saved", "save joints[None] or the whole clip"
        if width == 3 * joints:
            return "these are flat joints", f"save joints.reshape(-1, {joints}, 3)"
    return f"these are {frames} rows of {width}, neither features nor joints", ""

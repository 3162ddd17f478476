"""Split the body, and with it the columns of a feature row, into an upper and a lower part."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool

from kinema.motion.skeleton import Skeleton

PARTS = ("upper", "lower", "body")
"""The lower body is the root, the legs and the foot contacts; the upper all other joints (MDM §5).
`body` is all but the root's way over the floor: its turns and steps."""


def legs(skeleton: Skeleton) -> set[int]:
    """Return the joints of the chains that end in feet, the root among them."""
    feet = {*skeleton.feet_left, *skeleton.feet_right}
    return {joint for chain in skeleton.chains if feet & set(chain) for joint in chain}


def columns_of(part: str, skeleton: Skeleton) -> Bool[np.ndarray, " d"]:
    """Mark the columns of a full feature row that describe a part; raises ValueError for an unknown one."""
    if part not in PARTS:
        raise ValueError(f"unknown part of the body {part!r}; allowed: {', '.join(PARTS)}")
    if part == "body":
        return ~np.isin(np.arange(skeleton.feature_width), np.arange(3))
    lower = np.isin(np.arange(skeleton.num_joints), list(legs(skeleton)))
    columns = np.ones(skeleton.feature_width, dtype=bool)
    groups = skeleton.groups
    columns[groups["joints"]] = np.repeat(lower[1:], 3)
    columns[groups["rotations"]] = np.repeat(lower[1:], 6)
    columns[groups["velocities"]] = np.repeat(lower, 3)
    return columns if part == "lower" else ~columns

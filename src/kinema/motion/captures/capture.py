"""Hold a captured motion: a tree of named joints, and its rotations by frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from kinema.motion.resampling import blended, sample_times

USUAL_RATES = (12.5, 20, 24, 25, 30, 48, 50, 60, 72, 90, 100, 120, 200, 240)
"""Files print 1/30 as 0.0333: a rate this near to one of these is meant to be it (see `usual_rate`)."""

MOST = 20_000_000
"""Joints times frames of a capture: an hour of 90 joints at 60 frames per second, 2 GB of rotations and places."""


def check_size(path: Path, frames: int, joints: int) -> None:
    """Raise ValueError for a capture that would fill the memory: joints without channels cost its file nothing."""
    if frames * joints > MOST:
        raise ValueError(
            f"{path} has {joints} joints in {frames} frames; at most {MOST:,} places are read: cut it into takes"
        )


@dataclass(frozen=True, eq=False)
class Capture:
    """Hold a tree of joints, parents before children, in the file's own units and axes.

    `rotations` (T, J, 3, 3) turn a joint's children, in its parent's frame; `translations` (T, J, 3) lead from the
    parent to the joint, in the parent's frame too. `rest` (J, 3) are the translations of the pose without rotations.
    `up` is the axis that the file itself says is up, "z" or "-x", ...; None: it says nothing. `note` says what had to
    be decided to read the file.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    rotations: Float[np.ndarray, "t j 3 3"]
    translations: Float[np.ndarray, "t j 3"]
    rest: Float[np.ndarray, "j 3"]
    fps: float
    up: str | None = None
    note: str = ""

    @property
    def frames(self) -> int:
        """Count the frames T."""
        return len(self.rotations)

    @cached_property
    def positions(self) -> Float[np.ndarray, "t j 3"]:
        """Walk the tree: every joint's position in every frame."""
        turned = np.empty_like(self.rotations)
        found = np.empty_like(self.translations)
        for joint, parent in enumerate(self.parents):
            if parent < 0:
                turned[:, joint], found[:, joint] = self.rotations[:, joint], self.translations[:, joint]
                continue
            turned[:, joint] = turned[:, parent] @ self.rotations[:, joint]
            offset = np.einsum("tij,tj->ti", turned[:, parent], self.translations[:, joint])
            found[:, joint] = found[:, parent] + offset
        return found

    @cached_property
    def rest_positions(self) -> Float[np.ndarray, "j 3"]:
        """The positions of the pose without rotations, the root at its own offset."""
        found = self.rest.copy()
        for joint, parent in enumerate(self.parents):
            if parent >= 0:
                found[joint] += found[parent]
        return found

    def part(self, first: int, end: int | None = None) -> Capture:
        """Take the frames from `first` to before `end`."""
        return replace(self, rotations=self.rotations[first:end], translations=self.translations[first:end])

    def at(self, fps: float) -> Capture:
        """Resample to another rate: rotations along the shortest arc, translations linearly."""
        if fps == self.fps:
            return self
        early, late, share = sample_times(self.frames, self.fps, fps)
        start = Rotation.from_matrix(self.rotations[early].reshape(-1, 3, 3))
        step = start.inv() * Rotation.from_matrix(self.rotations[late].reshape(-1, 3, 3))
        part = Rotation.from_rotvec(step.as_rotvec() * np.repeat(share, len(self.names))[:, None])
        rotations = (start * part).as_matrix().reshape(len(share), -1, 3, 3)
        return replace(self, rotations=rotations, translations=blended(self.translations, early, late, share), fps=fps)


def usual_rate(fps: float) -> float:
    """Return the usual rate within half a percent, or the given one."""
    nearest = min(USUAL_RATES, key=lambda rate: abs(rate - fps))
    return nearest if abs(nearest - fps) < 0.005 * nearest else fps

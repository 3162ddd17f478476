"""Change a rigged motion for the tool that it is for: its place, facing, up axis, rate, or into a loop."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from annotated_types import Interval
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from kinema.motion.captures.capture import Capture
from kinema.options import Options

LOOP_SECONDS = 0.5
"""Over how long the end of a loop becomes its start."""

FrameRate = Annotated[float, Interval(ge=1, le=1000)]
Degrees = Annotated[float, Interval(ge=-360, le=360)]
Unit = Literal["cm", "m"]


@dataclass(frozen=True)
class Changes(Options):
    """Say how an exported motion differs: `fps` None is its own, `facing` degrees from +Z towards +X, None its own.

    `in_place`: the root stays over one spot. `loop`: the last frames become the first. `z_up`: Z is up, Y backward.
    `unit` is the file's, for formats that have none of their own.
    """

    fps: FrameRate | None = None
    in_place: bool = False
    facing: Degrees | None = None
    loop: bool = False
    z_up: bool = False
    unit: Unit = "cm"

    def apply(self, capture: Capture) -> Capture:
        """Make the changes, the up axis last; the unit is the writer's to change."""
        if self.loop:
            capture = looped(capture, LOOP_SECONDS)
        if self.in_place:
            capture = in_place(capture)
        if self.facing is not None:
            capture = facing(capture, self.facing)
        if self.fps is not None:
            capture = capture.at(self.fps)
        return z_up(capture) if self.z_up else capture


def in_place(capture: Capture) -> Capture:
    """Take the root's way over the floor out; its height stays."""
    moved = capture.translations.copy()
    moved[:, 0, [0, 2]] = moved[:1, 0, [0, 2]]
    return replace(capture, translations=moved)


def facing(capture: Capture, degrees: float) -> Capture:
    """Turn and move the motion: its first frame stands at the origin and faces so many degrees from +Z towards +X."""
    forward = capture.rotations[0, 0, :, 2]
    turn = Rotation.from_euler("y", degrees - np.degrees(np.arctan2(forward[0], forward[2])), degrees=True).as_matrix()
    rotations, moved = capture.rotations.copy(), capture.translations.copy()
    rotations[:, 0] = turn @ rotations[:, 0]
    moved[:, 0] = (moved[:, 0] - moved[0, 0] * [1, 0, 1]) @ turn.T
    return replace(capture, rotations=rotations, translations=moved)


def looped(capture: Capture, seconds: float) -> Capture:
    """Let the last frames become the first pose, at the place and heading where the motion has come to."""
    size = min(round(seconds * capture.fps), capture.frames - 1)
    if size < 1:
        return capture
    share = np.arange(1, size + 1) / size
    share = (share * share * (3 - 2 * share))[:, None]
    rotations, moved = capture.rotations.copy(), capture.translations.copy()
    heading = _heading(capture.rotations[-size:, 0]) @ _heading(capture.rotations[:1, 0]).swapaxes(1, 2)
    goal = np.broadcast_to(capture.rotations[0], (size, *capture.rotations.shape[1:])).copy()
    goal[:, 0] = heading @ goal[:, 0]
    rotations[-size:] = _between(rotations[-size:], goal, share)
    moved[-size:, 0, 1] += share[:, 0] * (moved[0, 0, 1] - moved[-size:, 0, 1])
    return replace(capture, rotations=rotations, translations=moved)


def z_up(capture: Capture) -> Capture:
    """Turn axes so that Z is up and what faced +Z faces -Y: the skeleton's rest pose too."""
    turn = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    return replace(
        capture,
        rotations=turn @ capture.rotations @ turn.T,
        translations=capture.translations @ turn.T,
        rest=capture.rest @ turn.T,
    )


def _heading(rotations: Float[np.ndarray, "t 3 3"]) -> Float[np.ndarray, "t 3 3"]:
    """The turn about +Y that a pelvis' forward axis makes."""
    yaw = np.arctan2(rotations[:, 0, 2], rotations[:, 2, 2])
    return Rotation.from_euler("y", yaw[:, None]).as_matrix()


def _between(
    start: Float[np.ndarray, "t j 3 3"], end: Float[np.ndarray, "t j 3 3"], share: Float[np.ndarray, "t 1"]
) -> Float[np.ndarray, "t j 3 3"]:
    """Turn from one to the other by a share, along the shortest arc."""
    first, second = (Rotation.from_matrix(r.reshape(-1, 3, 3)) for r in (start, end))
    step = (first.inv() * second).as_rotvec() * np.repeat(share[:, 0], start.shape[1])[:, None]
    return (first * Rotation.from_rotvec(step)).as_matrix().reshape(start.shape)

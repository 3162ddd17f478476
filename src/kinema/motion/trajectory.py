"""Take the root's way out of feature rows and put another in: what the body does stays, where it goes changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float

from kinema.motion.lifting import lift
from kinema.motion.recovery import recover_joints, recover_root
from kinema.motion.rotation import rotate_yaw
from kinema.motion.skeleton import Skeleton


@dataclass(frozen=True)
class Trajectory:
    """Hold a root's way: its yaw (radians, as `recover_root` has it: facing is -yaw from +Z towards +X) and place.

    `place` is x and z in the skeleton's unit.
    """

    yaw: Float[np.ndarray, " t"]
    place: Float[np.ndarray, "t 2"]

    @classmethod
    def of(cls, rows: Float[np.ndarray, "t d"]) -> Trajectory:
        """Integrate the root columns of rows."""
        yaw, root = recover_root(torch.from_numpy(rows[:, :4].astype(np.float64)))
        return cls(yaw.numpy(), root.numpy()[:, [0, 2]])

    def steer(self, rows: Float[np.ndarray, "t d"], skeleton: Skeleton) -> Float[np.ndarray, "t d"]:
        """Return rows that go this way, their redundant columns recomputed; the last row's step is its own still."""
        steered = rows.copy()
        if len(rows) < 2:
            return steered
        turn = (np.diff(self.yaw) + np.pi) % (2 * np.pi) - np.pi
        steered[:-1, 0] = turn / 2
        steered[:-1, 1:3] = rotate_yaw(_spread(np.diff(self.place, axis=0)), self.yaw[1:])[:, [0, 2]]
        return steered if rows.shape[1] <= skeleton.essential_width else lift(steered, skeleton)

    def joints(self, rows: Float[np.ndarray, "t d"], skeleton: Skeleton) -> Float[np.ndarray, "t j 3"]:
        """Place the bodies of rows along it."""
        own = Trajectory.of(rows)
        joints = recover_joints(torch.from_numpy(rows.astype(np.float64)), skeleton).numpy()
        turned = rotate_yaw(joints - _spread(own.place)[:, None], own.yaw - self.yaw)
        return (turned + _spread(self.place)[:, None]).astype(np.float32)


def pinned(made: Float[np.ndarray, "t d"], goal: Trajectory, held: Bool[np.ndarray, " t"]) -> Trajectory:
    """Lead a motion so that in held frames its root stands and faces as the goal's does; between them by parts."""
    own = Trajectory.of(made)
    here = np.flatnonzero(held)
    yaw = own.yaw + between(here, np.unwrap(goal.yaw[here] - own.yaw[here]), len(held))
    step = rotate_yaw(_spread(made[:-1, 1:3].astype(np.float64)), -yaw[1:])[:, [0, 2]]
    place = np.concatenate([np.zeros((1, 2)), step.cumsum(0)])
    return Trajectory(yaw, place + between(here, goal.place[here] - place[here], len(held)))


def faced(
    rows: Float[np.ndarray, "t d"],
    goal: Float[np.ndarray, "t d"],
    held: Bool[np.ndarray, " t"],
    skeleton: Skeleton,
) -> Float[np.ndarray, "t d"]:
    """Describe the same joints by other headings: in held frames those of the goal's rows, between them by parts.

    Where frame 0 gets another heading, the whole is turned by it: a row knows no other.
    """
    here = np.flatnonzero(held)
    if not len(here):
        return rows
    own, other = Trajectory.of(rows), Trajectory.of(goal)
    turn = between(here, np.unwrap(other.yaw[here] - own.yaw[here]), len(rows))
    local = rows[:, skeleton.groups["joints"]].reshape(len(rows), -1, 3)
    turned = rows.copy()
    turned[:, skeleton.groups["joints"]] = rotate_yaw(local.astype(np.float64), turn).reshape(len(rows), -1)
    return Trajectory(own.yaw + turn, own.place).steer(turned, skeleton)


def between(known: np.ndarray, values: Float[np.ndarray, "n *c"], size: int) -> Float[np.ndarray, "t *c"]:
    """Go gently from each known frame's value to the next one's; before the first and behind the last they stay.

    The frame behind a known one still has its value: the row of a known frame holds the step to the next.
    """
    frames = np.arange(size)
    left = np.clip(np.searchsorted(known, frames, side="right") - 1, 0, len(known) - 1)
    right = np.clip(left + 1, 0, len(known) - 1)
    start, end = known[left] + 1, known[right]
    share = np.where(right > left, np.clip((frames - start) / np.maximum(end - start, 1), 0, 1), 0)
    share = np.where(frames < known[0], 0, np.where((frames == end) & (right > left), 1, share))
    eased = (share * share * (3 - 2 * share)).reshape(-1, *[1] * (values.ndim - 1))
    return values[left] + eased * (values[right] - values[left])


def _spread(places: Float[np.ndarray, "t 2"]) -> Float[np.ndarray, "t 3"]:
    """Put x and z into space, at height 0."""
    return np.stack([places[:, 0], np.zeros(len(places)), places[:, 1]], axis=-1)

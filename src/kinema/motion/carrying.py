"""Carry a motion along a way over the floor: it walks as it does, but there."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d

from kinema.motion.features import facing_yaw
from kinema.motion.rotation import rotate_yaw
from kinema.motion.skeleton import Skeleton
from kinema.motion.trajectory import Trajectory

SWAY = 0.4
"""Seconds (standard deviation) over which the root's own way is smoothed: what is quicker is the body's sway."""
SLOW = 0.2
"""Metres per second below which a root has no direction of its own."""
TIMED = 0.1
"""Share of the progress along a way that is time, not distance: a body that stands on its way moves on all the same."""
STILL = 0.3
"""Metres: a motion that travels less is on no way."""


def carry(
    rows: Float[np.ndarray, "s d"],
    places: Float[np.ndarray, "t 2"],
    headings: Float[np.ndarray, " t"] | None,
    skeleton: Skeleton,
) -> tuple[Float[np.ndarray, "t d"], Trajectory, float]:
    """Return rows of t frames that go along `places` (skeleton units, a place a frame), their way, and the stride.

    Bodies are taken from the motion where it has come as far, so that feet move as the root does; sway and turns that
    are the body's own are kept on top. `headings` (radians from +Z towards +X) say which way it faces, otherwise it
    faces its way as it did. The stride says how much farther a step goes than the motion's own. Raises ValueError for
    a motion that hardly travels on a way that does.
    """
    rows = _begun(rows, skeleton)
    own, scale = Trajectory.of(rows), skeleton.meters * skeleton.fps
    base = smooth(own.place, SWAY * skeleton.fps)
    length, travelled = (skeleton.meters * float(_steps(way).sum()) for way in (places, base))
    if travelled < STILL < length:
        raise ValueError(
            f"the motion travels {travelled:.2f} m, the path {length:.2f} m: feet would only slide along it; take "
            "one that walks or runs (say so in the text)"
        )
    frames = np.interp(_progress(places), _progress(base), np.arange(len(rows)))
    along = course(places, scale) - _taken(course(base, scale), frames)
    turn = along
    if headings is not None:
        joints = own.joints(rows, skeleton).astype(np.float64)
        faced = np.unwrap([-facing_yaw(joints[i : i + 1], skeleton) for i in range(len(rows))])
        turn = headings - _taken(smooth(faced, SWAY * skeleton.fps), frames)
    sway, cos, sin = _taken(own.place - base, frames), np.cos(along), np.sin(along)
    swayed = np.stack([cos * sway[:, 0] + sin * sway[:, 1], cos * sway[:, 1] - sin * sway[:, 0]], axis=-1)
    way = Trajectory(_taken(np.unwrap(own.yaw), frames) - turn, places + swayed)
    stride = length / travelled if travelled > 0 else 1.0
    return way.steer(_taken(rows, frames).astype(np.float32), skeleton), way, stride


def course(places: Float[np.ndarray, "t 2"], scale: float) -> Float[np.ndarray, " t"]:
    """Return the direction of travel, radians from +Z towards +X; where it stands, between those around.

    `scale` makes metres per second of a step.
    """
    step = np.gradient(smooth(places, 2), axis=0) if len(places) > 1 else np.zeros((1, 2))
    moving = np.flatnonzero(scale * np.linalg.norm(step, axis=-1) > SLOW)
    if not len(moving):
        return np.zeros(len(places))
    return np.interp(np.arange(len(places)), moving, np.unwrap(np.arctan2(step[moving, 0], step[moving, 1])))


def smooth(values: np.ndarray, sigma: float) -> np.ndarray:
    """Smooth over time; the ends stay where they are."""
    around = min(round(4 * sigma), len(values) - 1)
    if around < 1:
        return values
    wide = np.pad(values, [(around, around), *[(0, 0)] * (values.ndim - 1)], mode="reflect", reflect_type="odd")
    return gaussian_filter1d(wide, sigma, axis=0, mode="nearest", radius=around)[around:-around]


def _begun(rows: Float[np.ndarray, "t d"], skeleton: Skeleton) -> Float[np.ndarray, "t d"]:
    """Let the first frame's heading be the second's: extraction sets it to 0, whatever it was (HUMANML3D_DATA §3.6)."""
    begun, jump = rows.copy(), float(2 * rows[0, 0])
    columns = skeleton.groups["joints"]
    joints = rows[0, columns].reshape(1, -1, 3)
    begun[0, columns] = rotate_yaw(joints, jump).reshape(-1)
    begun[0, 0] = 0
    return begun


def _progress(places: Float[np.ndarray, "t 2"]) -> Float[np.ndarray, " t"]:
    """Say how far along each frame is, from 0 to 1."""
    time = np.linspace(0, 1, len(places))
    gone = np.concatenate([[0], _steps(places).cumsum()])
    return time if gone[-1] <= 0 else TIMED * time + (1 - TIMED) * gone / gone[-1]


def _steps(places: Float[np.ndarray, "t 2"]) -> Float[np.ndarray, " s"]:
    return np.linalg.norm(np.diff(places, axis=0), axis=-1)


def _taken(values: np.ndarray, frames: Float[np.ndarray, " t"]) -> np.ndarray:
    """Take values between frames."""
    left = np.clip(np.floor(frames).astype(int), 0, len(values) - 1)
    right = np.minimum(left + 1, len(values) - 1)
    share = (frames - left).reshape(-1, *[1] * (values.ndim - 1))
    return values[left] + share * (values[right] - values[left])

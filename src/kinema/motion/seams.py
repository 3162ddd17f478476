"""Measure the seams of a chained motion against the motion's own parts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from kinema.motion.feet import runs
from kinema.motion.physics import FOOT_HEIGHT, SLIDING_SPEED
from kinema.motion.skeleton import Skeleton


@dataclass(frozen=True)
class Stretch:
    """Hold what a stretch of frames [start, end) looks like: at seams, that of the steps into and out of it too.

    `step`: the farthest that a joint goes from one frame to the next, metres. `jerk`: the largest mean over joints of
    the third difference of positions, m/s^3. `skating`: the share of low toes that slide (`physics.foot_skating`).
    """

    start: int
    end: int
    step: float
    jerk: float
    skating: float


def seams(
    joints: Float[np.ndarray, "t j 3"], kept: Bool[np.ndarray, " t"], skeleton: Skeleton, fps: float
) -> tuple[list[Stretch], Stretch]:
    """Measure each stretch that is not a part's own (`kept` False), and all else together."""
    meters = joints.astype(np.float64) * skeleton.meters
    found = []
    for start, end in runs(~kept):
        inside = np.zeros(len(kept), dtype=bool)
        inside[start:end] = True
        found.append(_measure(meters, inside, skeleton, fps, touching=True))
    return found, _measure(meters, kept, skeleton, fps, touching=False)


def _measure(
    meters: Float[np.ndarray, "t j 3"],
    inside: Bool[np.ndarray, " t"],
    skeleton: Skeleton,
    fps: float,
    *,
    touching: bool,
) -> Stretch:
    """Measure what touches the frames, or what lies in them altogether."""
    toes = meters[:, [skeleton.feet_left[1], skeleton.feet_right[1]]]
    low = toes[..., 1] < FOOT_HEIGHT
    low = low[1:] & low[:-1] & _spans(inside, 2, touching)[:, None]
    sliding = np.linalg.norm(np.diff(toes[..., [0, 2]], axis=0), axis=-1) * fps > SLIDING_SPEED
    step = np.linalg.norm(np.diff(meters, axis=0), axis=-1).max(-1)
    jerk = np.linalg.norm(np.diff(meters, 3, axis=0), axis=-1).mean(-1) * fps**3
    where = np.flatnonzero(inside)
    return Stretch(
        int(where[0]) if len(where) else 0,
        int(where[-1]) + 1 if len(where) else 0,
        float(step[_spans(inside, 2, touching)].max(initial=0)),
        float(jerk[_spans(inside, 4, touching)].max(initial=0)),
        float((low & sliding).sum() / max(low.sum(), 1)),
    )


def _spans(inside: Bool[np.ndarray, " t"], size: int, touching: bool) -> Bool[np.ndarray, " n"]:
    """Tell of every span of `size` frames whether it touches the frames, or lies in them."""
    spans = np.lib.stride_tricks.sliding_window_view(inside, size) if len(inside) >= size else np.zeros((0, size), bool)
    return np.asarray(spans.any(-1) if touching else spans.all(-1))

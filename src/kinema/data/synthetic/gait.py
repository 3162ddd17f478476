"""Step along a path: feet stand where they were put until they are lifted, the root follows the path."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kinema.data.synthetic.plan import Plan
from kinema.data.synthetic.tracks import FOOT_X, RAD, STANDING, TOE_OUT, Tracks, pulse, smooth

Path = Callable[[np.ndarray, float], tuple[np.ndarray, np.ndarray, np.ndarray]]
"""From the way gone (and its total, where it ends) to x, z and heading."""


@dataclass(frozen=True)
class Gait:
    """Hold how one steps: cycles per second, leg lengths per cycle, the share of a cycle that a foot stands, ...

    lift: how high feet are carried. heel: how far it rises at push-off (radians). swing: of the arms (radians).
    bounce: of the hips between steps. height: of the hips. width: half the distance between the feet.
    """

    cadence: float = 0.95
    stride: float = 1.5
    stance: float = 0.62
    lift: float = 0.09
    heel: float = 35 * RAD
    swing: float = 25 * RAD
    elbow: float = 20 * RAD
    bounce: float = 0.0
    height: float = STANDING
    width: float = FOOT_X


def straight(direction: float) -> Path:
    """Go straight, facing +Z, in a direction (0 ahead, pi/2 to the left)."""
    x, z = np.sin(direction), np.cos(direction)
    return lambda s, total: (s * x, s * z, 0 * s)


def arc(radius: float, sign: float = 1.0) -> Path:
    """Go round to the left (sign 1; to the right with -1) on a circle."""
    return lambda s, total: (
        sign * radius * (1 - np.cos(s / radius)),
        radius * np.sin(s / radius),
        sign * s / radius,
    )


def weave(length: float, amplitude: float) -> Path:
    """Go ahead in bends, one left and one right per length, the heading swinging by `amplitude`."""
    k = 2 * np.pi / length
    return lambda s, total: (amplitude / k * (1 - np.cos(k * s)), s, amplitude * np.sin(k * s))


def turn(angle: float) -> Path:
    """Turn on the spot by an angle."""
    return lambda s, total: (0 * s, 0 * s, angle * s / total)


def step(
    plan: Plan, gait: Gait, path: Path, *, seconds: float = 4.0, cycles: int | None = None
) -> tuple[Tracks, np.ndarray]:
    """Step along a path: for so many cycles from standing to standing, or steadily for so many seconds.

    A closed plan always goes from standing to standing. The left foot steps first.
    Gives the tracks and the phase in cycles; the left foot is put down at whole numbers, the right one between.
    """
    cadence = gait.cadence * plan.tempo
    if plan.closed and cycles is None:
        cycles = max(2, int((min(seconds, plan.longest) - 0.6) * cadence))
    if cycles is None:
        tracks, first, ease = plan.stand(seconds), plan.uniform(0, 1), 0.0
        phase = first + cadence * tracks.time
        progress, total = (lambda p: p - first), float("nan")
    else:
        ease = min(0.4, 0.45 * (cycles - 0.5))
        lead = plan.uniform(0.05, 0.3)
        tracks = plan.stand(lead + cycles / cadence + plan.uniform(0.2, 0.5))
        first = gait.stance - 0.02
        phase = first + np.clip((tracks.time - lead) * cadence, 0, cycles)
        # The root moves between the middle of the first right stance and that of the last left one: then both feet
        # start and end beside it.
        begin, end = 0.5 + gait.stance / 2, cycles + gait.stance / 2
        progress, total = (lambda p: _eased(p, begin, end, ease)), (end - begin - ease) * gait.stride * plan.size
    way = gait.stride * plan.size
    tracks.root[:, 0], tracks.root[:, 2], tracks.heading = path(progress(phase) * way, total)
    moving = np.ones(tracks.frames) if cycles is None else _moving(phase, first, cycles)
    for side in (0, 1):
        tracks.feet[:, side] = _feet(gait, plan, phase + side / 2, side, lambda p: path(progress(p) * way, total))
    tracks.feet[:, :, 4] *= moving[:, None]
    beat = np.cos(4 * np.pi * (phase - gait.stance / 2))
    tracks.root[:, 1] = STANDING + moving * (gait.height - STANDING - gait.bounce * beat)
    swing = np.cos(2 * np.pi * phase) * gait.swing * plan.size * moving
    for side, sign in enumerate((-1, 1)):
        tracks.arms[:, side, 0] += sign * swing
        tracks.arms[:, side, 4] += moving * (gait.elbow + 0.4 * sign * swing)
    tracks.spine[:, 1] += 0.2 * swing
    tracks.pelvis[:, 1] -= 0.15 * swing
    return tracks, phase


def _eased(p: np.ndarray, begin: float, end: float, ease: float) -> np.ndarray:
    """Return the way gone from `begin` to `end`, speeding up and slowing down over `ease` of the phase."""

    def ramp(x: np.ndarray) -> np.ndarray:
        y = np.clip(x / ease, 0, 1)
        return np.where(x > ease, x - ease / 2, ease * (y**3 - y**4 / 2))

    return np.where(p < (begin + end) / 2, ramp(p - begin), end - begin - ease - ramp(end - p))


def _moving(phase: np.ndarray, first: float, cycles: int) -> np.ndarray:
    """Fade in and out what accompanies the steps."""
    return smooth((phase - first) / 0.4) * smooth((first + cycles - phase) / 0.4)


def _feet(
    gait: Gait, plan: Plan, phase: np.ndarray, side: int, at: Callable[[np.ndarray], tuple[np.ndarray, ...]]
) -> np.ndarray:
    """Return one foot's channels: on the floor under the path's point of mid-stance, or on its way to the next one."""
    index = np.floor(phase)
    u = phase - index
    sway = np.clip((u - gait.stance) / (1 - gait.stance), 0, 1)
    places = []
    for ahead in (0, 1):
        x, z, yaw = at(index + ahead + gait.stance / 2 - side / 2)
        across = gait.width * (1 - 2 * side)
        places.append(np.stack([x + across * np.cos(yaw), 0 * x, z - across * np.sin(yaw), yaw, 0 * yaw], axis=-1))
    foot = places[0] + (sway * sway * (3 - 2 * sway))[:, None] * (places[1] - places[0])
    foot[:, 1] = gait.lift * plan.size * pulse(sway, 0.45, 0.55)
    rise = smooth((u - 0.65 * gait.stance) / (0.4 * gait.stance)) * smooth((1 - sway) / 0.75)
    foot[:, 3] += TOE_OUT * (1 - 2 * side)
    foot[:, 4] = gait.heel * rise - 12 * RAD * np.sin(np.pi * np.clip((sway - 0.5) / 0.5, 0, 1)) ** 2
    return foot

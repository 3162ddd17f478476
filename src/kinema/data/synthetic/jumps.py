"""Actions that leave the floor: flight is ballistic, push-off and landing meet its speed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinema.data.synthetic.plan import Plan, action
from kinema.data.synthetic.tracks import FOOT_X, Tracks, smooth

GRAVITY = 11.5
"""Leg lengths per second squared, for a leg of 0.85 m."""


@dataclass(frozen=True)
class Leaps:
    """Hold a row of jumps: the standing tracks, how far each has flown and how crouched and how tall one is.

    `flown` counts jumps, growing only in the air; `carried` is the same for the hips, which start before the feet.
    """

    tracks: Tracks
    flown: np.ndarray
    carried: np.ndarray
    airborne: np.ndarray
    index: np.ndarray


def leap(plan: Plan, count: int, height: float, crouch: float, *, rest: float = 0.25) -> Leaps:
    """Jump so many times, hips rising by `height` leg lengths and falling by `crouch` before and after."""
    speed = np.sqrt(2 * GRAVITY * height)
    flight, push, dip = 2 * speed / GRAVITY, 2 * crouch / speed, 0.28 / plan.tempo
    recover = dip + rest * plan.uniform(0.6, 1.2) / plan.tempo
    period = dip + 2 * push + flight + recover
    tracks, u, index = plan.repeat(count, period * plan.tempo)
    since = u * period - dip - push  # seconds since take-off
    rise = speed * since - GRAVITY * since**2 / 2
    down = smooth(1 + (since + push) / dip)
    up = smooth((since - flight - push) / recover)
    pushed = np.clip(1 + since / push, 0, 1) ** 2
    landed = 1 - (1 - np.clip((since - flight) / push, 0, 1)) ** 2
    flying = (since > 0) & (since < flight)
    drop = np.where(since <= 0, crouch * down * (1 - pushed), crouch * landed * (1 - up))
    airborne = np.where(flying, rise, 0.0)
    tracks.root[:, 1] += np.where(flying, rise, -drop)
    tracks.trunk(drop, lean=90)
    flown = index + np.clip(since / flight, 0, 1)
    carried = index + smooth((since + push) / (flight + 2 * push))
    heel = smooth(1 + since / (0.7 * push)) * smooth((flight - since) / (0.5 * flight))
    for side in (0, 1):
        tracks.foot(side, airborne, lift=1.0)
        tracks.foot(side, heel, heel=45)
    return Leaps(tracks, flown, carried, airborne / height, index)


def _carry(leaps: Leaps, x: float, z: float, yaw: float = 0.0) -> None:
    """Move by (x, z) and turn by yaw with every jump."""
    tracks, turn = leaps.tracks, yaw * leaps.flown
    tracks.root[:, 0] += x * leaps.carried
    tracks.root[:, 2] += z * leaps.carried
    tracks.heading += turn
    c, s = np.cos(turn), np.sin(turn)
    for side in (0, 1):
        px, pz = tracks.feet[:, side, 0].copy(), tracks.feet[:, side, 2].copy()
        tracks.feet[:, side, 0] = c * px + s * pz + x * leaps.flown
        tracks.feet[:, side, 2] = -s * px + c * pz + z * leaps.flown
        tracks.feet[:, side, 3] += turn


@action("*jump {way} {count}", "*jump {way} {count}", "*leap {way} {count}", "*do a jump {way} {count}")
def jump(plan: Plan) -> Tracks:
    way = plan.choose(
        "way",
        {
            "high": ("high up", "up high in the air"),
            "low": ("up a little", "a little bit up"),
            "forward": ("forward", "ahead"),
            "backward": ("backward", "back"),
            "side": ("to the {side}", "sideways to the {side}"),
            "turn": ("and *turn around {turn} in the air", "with a half turn {turn}"),
        },
    )
    height = {"high": plan.uniform(0.3, 0.4), "low": plan.uniform(0.07, 0.11)}.get(way, plan.uniform(0.16, 0.24))
    leaps = leap(plan, plan.count(1.5, 4), height * min(plan.size, 1.1), 0.24 if way != "low" else 0.12)
    far = plan.uniform(0.7, 1.0) * plan.size
    x, z = {"forward": (0, far), "backward": (0, -0.7 * far), "side": (0.8 * far, 0)}.get(way, (0, 0))
    _carry(leaps, x, z, np.pi if way == "turn" else 0.0)
    for side in (0, 1):
        leaps.tracks.arm(side, leaps.airborne, swing=150 if way == "high" else 55, elbow=30)
    return leaps.tracks


@action(
    "*hop {way} on the {side} foot {count}",
    "*hop {way} on the {side} leg {count}",
    "*jump {way} on the {side} leg {count}",
)
def hop(plan: Plan) -> Tracks:
    way = plan.choose("way", {"here": ("in place", "on the spot"), "forward": ("forward", "ahead")})
    count = 1 + plan.count(0.9, 4)
    names = {2: ("twice", "two times"), 3: ("three times",), 4: ("four times",), 5: ("five times",)}
    plan.words["count"] = names[count]
    leaps = leap(plan, count, plan.uniform(0.06, 0.1), 0.09, rest=0.0)
    tracks = leaps.tracks
    _carry(leaps, 0, plan.uniform(0.35, 0.5) if way == "forward" else 0)
    lifted = plan.held(tracks, 0.5, 0.5)
    tracks.foot(1, lifted, lift=0.42, z=-0.38, heel=55, x=FOOT_X * 0.6)
    tracks.hips(lifted, x=FOOT_X * 0.7)
    for side in (0, 1):
        tracks.arm(side, lifted, out=45, elbow=40)
    return tracks


@action("*do {number}", "*perform {number}")
def jumping_jacks(plan: Plan) -> Tracks:
    names: dict[int, tuple[str, ...]] = {1: ("a jumping jack", "one jumping jack")}
    names |= {n: (f"{w} jumping jacks",) for n, w in ((2, "two"), (3, "three"), (4, "four"), (5, "five"))}
    fits = int((plan.longest - 1.2) * plan.tempo / 1.9)
    count = plan.choose("number", {n: names[n] for n in range(1, max(1, min(5, fits)) + 1)})
    leaps = leap(plan, 2 * count, 0.07, 0.08, rest=-0.2)
    part = leaps.flown - 2 * np.floor(leaps.flown / 2)
    wide = smooth(1 - np.abs(part - 1))
    for side, sign in enumerate((1, -1)):
        leaps.tracks.foot(side, wide, x=0.27 * sign)
        leaps.tracks.arm(side, wide, out=165, elbow=12)
    return leaps.tracks

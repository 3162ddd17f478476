"""Give a body volume: balls with a skin between them, as the players of the browser have it (figure.js)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int
from scipy.ndimage import uniform_filter

from kinema.motion.rotation import unit
from kinema.motion.view.body import Body

FAN = 9
"""Balls from hip to hip and from shoulder to shoulder, each with a skin to both ends of the spine's part between."""
LIGHT = unit(np.array([-0.42, 0.58, 0.7]))
"""Where light comes from: right, up and towards the viewer."""
FINE = 2
"""Samples of a pixel along each axis."""
SOFT = 0.035
"""Statures over which light on a trunk is the mean of what is around: its skins are one."""
LEAST = 1e-6
"""What is divided by is this at least."""


@dataclass(frozen=True)
class Piece:
    """Hold a part of a body: balls (x, y, z, radius in metres), the pairs that a skin lies around, and its side."""

    balls: Float[np.ndarray, "k 4"]
    bones: tuple[tuple[int, int], ...]
    side: int


def pieces(pose: Float[np.ndarray, "j 3"], body: Body) -> list[Piece]:
    """Build a body around a pose: trunk, limbs, feet, hands and head."""
    size = body.stature
    balls = np.concatenate([pose, size * np.array(body.radii)[:, None]], axis=1)

    def beyond(joint: int, by: float, radius: float) -> np.ndarray:
        """Go on from a joint the way that its bone goes."""
        way = unit(pose[joint] - pose[body.parents[joint]])
        return np.append(pose[joint] + by * size * way, radius * size)

    made = [_trunk(balls[list(joints)]) for joints in body.trunk]
    for joint in body.bones:
        parent = body.parents[joint]
        ends = [balls[parent], balls[joint]]
        if joint in body.toes:
            made.append(_all(np.stack([*ends, beyond(parent, 0.03, 0.021)]), body.sides[joint]))
        else:
            made.append(Piece(np.stack(ends), ((0, 1),), body.sides[joint]))
    for joint in body.hands:
        hand = np.stack([balls[joint], beyond(joint, 0.035, 0.021), beyond(joint, 0.075, 0.011)])
        made.append(Piece(hand, ((0, 1), (1, 2)), body.sides[joint]))
    return [*made, _head(pose, body)]


def _trunk(balls: Float[np.ndarray, "k 4"]) -> Piece:
    """Lay a skin around a part of the spine (its ends first and last) and what stands out to both sides of it."""
    bottom, right, left, *spine = balls
    across = right + np.linspace(0, 1, FAN)[:, None] * (left - right)
    middle = [bottom, *spine]
    fan = [(end, len(middle) + i) for end in (0, len(middle) - 1) for i in range(FAN)]
    return Piece(np.stack([*middle, *across]), (*pairwise(range(len(middle))), *fan), 0)


def _head(pose: Float[np.ndarray, "j 3"], body: Body) -> Piece:
    """Build a skull with chin and nose: they say which way the face looks."""
    r_hip, l_hip, r_shoulder, l_shoulder = pose[list(body.face_joints)]
    up = unit(pose[body.head] - pose[body.parents[body.head]])
    ahead = unit(np.cross(l_shoulder - r_shoulder + 0.3 * (l_hip - r_hip), up))
    balls = [
        np.append(pose[body.head] + body.stature * (rise * up + front * ahead), radius * body.stature)
        for rise, front, radius in ((0.085, 0.005, 0.053), (0.035, 0.016, 0.037), (0.06, 0.058, 0.009))
    ]
    return _all(np.stack(balls), 0)


def _all(balls: Float[np.ndarray, "k 4"], side: int) -> Piece:
    """Lay a skin around three balls, each with each."""
    return Piece(balls, ((0, 1), (1, 2), (0, 2)), side)


@dataclass(frozen=True)
class Seen:
    """Hold what a picture shows, from its upper row down: light (-1 to 1), nearness (-inf: nothing) and whose it is."""

    light: Float[np.ndarray, "h w"]
    near: Float[np.ndarray, "h w"]
    piece: Int[np.ndarray, "h w"]

    def softened(self, pieces: int, reach: int) -> Seen:
        """Return it with light on the first so many pieces that is the mean of so many pixels around."""
        whole = (self.piece >= 0) & (self.piece < pieces)
        spots = np.nonzero(whole)
        if not len(spots[0]):
            return self
        part = tuple(slice(spot.min(), spot.max() + 1) for spot in spots)
        there, light = whole[part], self.light.copy()
        share, lit = there.astype(float), np.where(there, light[part], 0)
        for _ in range(2):
            share, lit = uniform_filter(share, reach, mode="constant"), uniform_filter(lit, reach, mode="constant")
        light[part] = np.where(there, lit / np.maximum(share, LEAST), light[part])
        return replace(self, light=light)


def look(bones: Float[np.ndarray, "n 2 4"], owners: list[int], width: int, height: int) -> Seen:
    """Look along Z at the skins of bones, each between two balls (x, y, z, radius in pixels; y from the lower edge)."""
    seen = Seen(np.zeros((height, width)), np.full((height, width), -np.inf), np.full((height, width), -1))
    for (start, end), owner in zip(bones, owners, strict=True):
        low = np.floor(np.minimum(start[:2] - start[3], end[:2] - end[3])).astype(int).clip(0)
        high = np.ceil(np.maximum(start[:2] + start[3], end[:2] + end[3])).astype(int).clip(0, (width, height))
        if (high <= low).any():
            continue
        rows, columns = slice(height - high[1], height - low[1]), slice(low[0], high[0])
        x = np.arange(low[0], high[0]) + 0.5
        y = (np.arange(low[1], high[1]) + 0.5)[::-1, None]
        light, near = _skin(x, y, start, end)
        with_it = near > seen.near[rows, columns]
        for into, values in ((seen.light, light), (seen.near, near), (seen.piece, owner)):
            into[rows, columns] = np.where(with_it, values, into[rows, columns])
    return seen


def _skin(
    x: Float[np.ndarray, " w"], y: Float[np.ndarray, "h 1"], start: np.ndarray, end: np.ndarray
) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    """Find light and nearness of the skin around two balls and all between them; -inf beside it.

    At a share t of the bone the ball's surface is z(t) + sqrt(q(t)) near, with q a square in t: a concave function,
    whose highest point is the skin's. Of a bone that points at the viewer that may be an end.
    """
    (dx, dy, dz, dr), radius = end - start, start[3]
    x, y = x - start[0], y - start[1]
    bend = dx * dx + dy * dy - dr * dr
    shares: list[np.ndarray | float] = [] if bend > LEAST else [0.0, 1.0]
    if abs(bend) > LEAST and bend + dz * dz > LEAST:
        slope = dx * x + dy * y + radius * dr
        top = np.maximum(slope * slope + bend * (radius * radius - x * x - y * y), 0) / (bend + dz * dz)
        shares.append(((slope + dz * np.sqrt(top)) / bend).clip(0, 1))
    found = [_ball(x - share * dx, y - share * dy, start[2] + share * dz, radius + share * dr) for share in shares]
    light, near = found[0]
    for other, nearer in found[1:]:
        light, near = np.where(nearer > near, other, light), np.maximum(near, nearer)
    return light, near


def _ball(
    x: np.ndarray, y: np.ndarray, z: np.ndarray | float, radius: np.ndarray | float
) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    """Find light and nearness of balls, whose middles are so far from each pixel."""
    q = radius * radius - x * x - y * y
    rise = np.sqrt(np.maximum(q, 0))
    light = (LIGHT[0] * x + LIGHT[1] * y + LIGHT[2] * rise) / radius
    return light, np.where(q >= 0, z + rise, -np.inf)

"""Hold feet where they stand: contacts from height and speed, legs bent to meet them; nothing else moves.

A toe that is low and slow stands (at its median place over the contact); ankle and toe are moved there, around the
contact by parts, and the knee follows by two-bone inverse kinematics, bent to the side that it was bent to. Between
contacts a toe that would sweep the floor is lifted over it; one that slides far while it stands takes steps. The
numbers were chosen on motion that was generated for captions of a validation split (docs/export.md).
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

from kinema.motion.rotation import shortest_arc, unit
from kinema.motion.skeleton import Skeleton

LOW, SLOW = 0.06, 0.7
"""Metres above the floor and metres per second below which a toe is taken to stand."""
SHORTEST, GAP = 0.15, 0.1
"""Seconds: shorter contacts are left alone, gaps between contacts that are no longer are closed."""
FAR, STEP = 0.2, 0.2
"""Metres that a toe stands from its place at most: one that slides farther takes steps of so many seconds."""
HOLD, RISE = 0.05, 0.1
"""Seconds before and behind a contact in which a toe moves up and down alone, and in which it is clear of the floor."""
BLEND = 0.25
"""Seconds over which a foot goes from where it was to where it stands."""
CLEAR = 0.06
"""Metres that a toe is lifted to in the middle between two contacts."""
FARTHEST = 0.999
"""Share of a leg's length that it is stretched to at most."""


@dataclass(frozen=True)
class Leg:
    """Name the joints of one leg."""

    hip: int
    knee: int
    ankle: int
    toe: int


def legs(skeleton: Skeleton) -> tuple[Leg, Leg]:
    """Find the legs of a skeleton: the chains that end in its toes."""
    found = []
    for ankle, toe in (skeleton.feet_left, skeleton.feet_right):
        knee = skeleton.parents[ankle]
        found.append(Leg(skeleton.parents[knee], knee, ankle, toe))
    return found[0], found[1]


def lock_feet(joints: Float[np.ndarray, "t j 3"], skeleton: Skeleton, fps: float) -> Float[np.ndarray, "t j 3"]:
    """Return the motion with feet that stand held still; joints in the skeleton's unit, the floor at y = 0."""
    moved = np.array(joints, dtype=np.float64) * skeleton.meters
    hips, knees, ankles, toes = (list(both) for both in zip(*map(astuple, legs(skeleton)), strict=True))
    shift = np.stack([_shifts(moved[:, toe], fps) for toe in toes], axis=1)
    foot = moved[:, toes] - moved[:, ankles]
    moved[:, knees], moved[:, ankles] = _bend(
        moved[:, hips], moved[:, knees], moved[:, ankles], moved[:, ankles] + shift
    )
    moved[:, toes] = moved[:, ankles] + foot
    return moved / skeleton.meters


def contacts(toe: Float[np.ndarray, "t 3"], fps: float) -> Bool[np.ndarray, " t"]:
    """Tell in which frames a toe stands."""
    speed = _over_floor(np.gradient(toe, axis=0)) * fps if len(toe) > 1 else np.zeros(1)
    standing = (toe[:, 1] < LOW) & (speed < SLOW)
    standing = ~_without_short(~standing, round(GAP * fps) + 1, inside=True)
    for start, end in runs(standing):
        _step(toe, standing, start, end, fps)
    return _without_short(standing, round(SHORTEST * fps))


def _step(toe: Float[np.ndarray, "t 3"], standing: Bool[np.ndarray, " t"], start: int, end: int, fps: float) -> None:
    """Let a toe that stands too far from its place step in the middle of its contact, and in the halves' middles."""
    away = _over_floor(toe[start:end] - _median(toe[start:end]))
    size, middle = round(STEP * fps), (start + end) // 2
    if away.max() <= FAR or end - start < size + 2 * round(SHORTEST * fps):
        return
    left, right = middle - size // 2, middle - size // 2 + size
    standing[left:right] = False
    _step(toe, standing, start, left, fps)
    _step(toe, standing, right, end, fps)


def drift(toe: Float[np.ndarray, "t 3"], standing: Bool[np.ndarray, " t"]) -> list[float]:
    """Return how far a toe comes from where it began to stand, over the floor, of each contact."""
    return [float(_over_floor(toe[start:end] - toe[start]).max()) for start, end in runs(standing)]


def runs(flags: Bool[np.ndarray, " t"]) -> list[tuple[int, int]]:
    """List the runs of true frames, [start, end)."""
    outside = np.zeros(len(flags) + 2, dtype=bool)
    outside[1:-1] = flags
    edges = np.flatnonzero(outside[1:] != outside[:-1]).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))


def _without_short(flags: Bool[np.ndarray, " t"], shortest: int, *, inside: bool = False) -> Bool[np.ndarray, " t"]:
    """Drop runs of fewer frames; `inside`: those that end the clip are kept."""
    kept = flags.copy()
    for start, end in runs(flags):
        if end - start < shortest and not (inside and (start == 0 or end == len(flags))):
            kept[start:end] = False
    return kept


def _shifts(toe: Float[np.ndarray, "t 3"], fps: float) -> Float[np.ndarray, "t 3"]:
    """Say by how much the foot moves in each frame: as `_shift` says, up off the floor and clear of it between."""
    standing = contacts(toe, fps)
    shift = _shift(toe, standing, fps)
    shift[:, 1] = np.maximum(0, _clearance(standing, fps) - toe[:, 1])
    return shift


def _shift(toe: Float[np.ndarray, "t 3"], standing: Bool[np.ndarray, " t"], fps: float) -> Float[np.ndarray, "t 3"]:
    """Say by how much the foot moves in each frame, horizontally: to its place in contacts, by parts around them."""
    shift, size, blend = np.zeros_like(toe), len(toe), max(round(BLEND * fps), 1)
    found, hold = runs(standing), round(HOLD * fps)
    held = [(max(start - hold, 0), min(end + hold, size)) for start, end in found]
    for (start, end), (first, last) in zip(found, held, strict=True):
        place = _median(toe[start:end])
        shift[first:last] = (place - toe[first:last]) * [1, 0, 1]
    edges = [(0, 0), *held, (size, size)]
    for (_, left), (right, _) in pairwise(edges):
        frames = np.arange(left, right)
        if left > 0:
            shift[frames] += _ease(1 - (frames - left + 1) / (blend + 1))[:, None] * shift[left - 1]
        if right < size:
            shift[frames] += _ease(1 - (right - frames) / (blend + 1))[:, None] * shift[right]
    return shift


def _clearance(standing: Bool[np.ndarray, " t"], fps: float) -> Float[np.ndarray, " t"]:
    """Say how high a toe is at least: on the floor where it stands, risen and lowered by parts between contacts."""
    height, blend = np.zeros(len(standing)), max(round(RISE * fps), 1)
    for start, end in runs(~standing):
        frames = np.arange(start, end)
        to_edge = np.minimum(
            frames - start + 1 if start > 0 else len(standing), end - frames if end < len(standing) else len(standing)
        )
        height[start:end] = CLEAR * _ease(to_edge / blend) if standing.any() else 0
    return height


def _ease(share: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Start and end gently: 0 and below give 0, 1 gives 1."""
    share = np.minimum(np.maximum(share, 0), 1)
    return share * share * (3 - 2 * share)


def _over_floor(way: Float[np.ndarray, "t 3"]) -> Float[np.ndarray, " t"]:
    """Return how far ways go horizontally."""
    return np.hypot(way[:, 0], way[:, 2])


def _median(values: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " 3"]:
    """Return the median: np.median's checks cost more than a contact's few values."""
    ordered, half = np.sort(values, axis=0), len(values) // 2
    return ordered[half] if len(values) % 2 else (ordered[half - 1] + ordered[half]) / 2


def _bend(
    hip: Float[np.ndarray, "t l 3"],
    knee: Float[np.ndarray, "t l 3"],
    ankle: Float[np.ndarray, "t l 3"],
    wanted: Float[np.ndarray, "t l 3"],
) -> tuple[Float[np.ndarray, "t l 3"], Float[np.ndarray, "t l 3"]]:
    """Move ankles to where they are wanted, as far as the leg reaches: knees and ankles; bones keep their lengths."""
    thigh, shin = np.linalg.norm(knee - hip, axis=-1), np.linalg.norm(ankle - knee, axis=-1)
    before, after = ankle - hip, wanted - hip
    reach = np.clip(np.linalg.norm(after, axis=-1), np.abs(thigh - shin) * (2 - FARTHEST), (thigh + shin) * FARTHEST)
    still = np.linalg.norm(wanted - ankle, axis=-1) < 1e-9
    axis = unit(after)
    turned = np.einsum("...ij,...j->...i", shortest_arc(unit(before), axis), knee - hip)
    side = turned - np.einsum("...i,...i->...", turned, axis)[..., None] * axis
    along = (thigh**2 - shin**2 + reach**2) / (2 * np.maximum(reach, 1e-9))
    across = np.sqrt(np.maximum(thigh**2 - along**2, 0))
    new_knee = hip + along[..., None] * axis + across[..., None] * unit(side)
    new_ankle = hip + reach[..., None] * axis
    keep = still[..., None]
    return np.where(keep, knee, new_knee), np.where(keep, ankle, new_ankle)

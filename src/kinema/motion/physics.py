"""Measure how physical motions are; torch, batched, frames past the lengths ignored.

Foot skating: of the frames where a toe is low (y < 5 cm at t and t+1), the share in which it slides (horizontal
speed above 0.5 m/s). Jitter: the norm of the third difference of positions times fps^3, averaged over joints and
frames, m/s^3. Float and penetration: how far the lowest joint is above or below the floor, averaged over frames, mm;
within 5 mm counts as 0 (Yuan et al. 2023, PhysDiff; theirs is the lowest vertex of a body mesh). Heading:
h_t = 2 sum_{s<t} a_s, a the half-angle column; turn angle = h_L. Root speed: the norm of the horizontal root velocity,
averaged over frames. Root velocity deviation: the square root of its variance over frames, averaged over x and z.

Evaluators hardly see heading, turn angle and root speed, so they are measured on their own.
"""

from __future__ import annotations

from jaxtyping import Bool, Float, Int
from torch import Tensor

from kinema.motion.skeleton import Skeleton
from kinema.types import frame_mask

FOOT_HEIGHT = 0.05
"""Metres above the floor (y = 0) below which a toe should stand still."""

SLIDING_SPEED = 0.5
"""Metres per second: a faster toe near the floor slides."""

FLOOR_TOLERANCE = 0.005
"""Metres above or below the floor that count as standing on it."""


def foot_skating(
    joints: Float[Tensor, "b t j 3"], lengths: Int[Tensor, " b"], skeleton: Skeleton
) -> Float[Tensor, " b"]:
    """Return the share of toe contacts that slide, in [0, 1]; 0 for a clip without contact.

    `joints` are in the skeleton's unit, at its frame rate, with the floor at y = 0.
    """
    toes = joints[:, :, [skeleton.feet_left[1], skeleton.feet_right[1]]] * skeleton.meters
    low = toes[..., 1] < FOOT_HEIGHT
    low = low[:, 1:] & low[:, :-1] & frame_mask(lengths - 1, toes.shape[1] - 1)[..., None]
    speed = toes[..., [0, 2]].diff(dim=1).norm(dim=-1) * skeleton.fps
    contacts = low.sum((1, 2))
    sliding = (low & (speed > SLIDING_SPEED)).sum((1, 2))
    return sliding / contacts.clamp(min=1)


def jitter(
    joints: Float[Tensor, "b t j 3"], lengths: Int[Tensor, " b"], fps: float, unit: str = "m"
) -> Float[Tensor, " b"]:
    """Return the mean magnitude of the third derivative of positions, m/s^3; 0 for clips of fewer than 4 frames.

    `unit` is the joints' ("m" or "mm"; a skeleton knows its own).
    """
    if unit not in ("m", "mm"):
        raise ValueError(f"unknown unit {unit!r}; choose 'm' or 'mm' (skeleton.unit)")
    meters = joints if unit == "m" else joints * 1e-3
    third = meters.diff(n=3, dim=1).norm(dim=-1).mean(-1) * fps**3
    return _masked_mean(third, frame_mask(lengths - 3, third.shape[1]))


def floor_distances(
    joints: Float[Tensor, "b t j 3"], lengths: Int[Tensor, " b"], skeleton: Skeleton
) -> tuple[Float[Tensor, " b"], Float[Tensor, " b"]]:
    """Return how far the lowest joint floats above the floor (y = 0) and sinks below it, means over frames, mm.

    A frame within the tolerance counts as 0, any other by its whole distance. `joints` are in the skeleton's unit.
    """
    lowest = joints[..., 1].amin(-1) * skeleton.meters
    away = lowest.masked_fill(lowest.abs() <= FLOOR_TOLERANCE, 0) * 1000
    mask = frame_mask(lengths, joints.shape[1])
    return _masked_mean(away.clamp(min=0), mask), _masked_mean((-away).clamp(min=0), mask)


def heading_at(features: Float[Tensor, "b t d"], frames: Int[Tensor, " b"]) -> Float[Tensor, " b"]:
    """Return the signed heading that each motion has turned through when frame `frames` begins, radians, unwrapped.

    It is the yaw of recovery: positive is a turn to the character's right (clockwise seen from above).
    """
    return 2 * _masked(features[..., 0], frame_mask(frames, features.shape[1])).sum(1)


def turn_angle(features: Float[Tensor, "b t d"], lengths: Int[Tensor, " b"]) -> Float[Tensor, " b"]:
    """Return the signed total turn over all rows, radians: L rows span the L+1 poses they came from."""
    return heading_at(features, lengths)


def _masked(values: Float[Tensor, "b t"], mask: Bool[Tensor, "b t"]) -> Float[Tensor, "b t"]:
    """Zero what is masked, NaN included."""
    return values.masked_fill(~mask, 0)


def _masked_mean(values: Float[Tensor, "b t"], mask: Bool[Tensor, "b t"]) -> Float[Tensor, " b"]:
    """Average the unmasked values of each row; 0 where there are none."""
    return _masked(values, mask).sum(1) / mask.sum(1).clamp(min=1)

"""Pose a body of either skeleton along tracks: forward kinematics above, two-bone inverse kinematics for the legs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinema.data.synthetic.tracks import Tracks
from kinema.motion.skeleton import HUMANML3D, Skeleton, get_skeleton


@dataclass(frozen=True)
class Layout:
    """Name which joints of a skeleton play which part; limbs are given for (left, right), from the trunk outwards."""

    spine: tuple[int, ...]
    head: tuple[int, ...]
    legs: tuple[tuple[int, ...], tuple[int, ...]]
    arms: tuple[tuple[int, ...], tuple[int, ...]]


LAYOUTS = {
    "humanml3d": Layout((3, 6, 9), (12, 15), ((1, 4, 7, 10), (2, 5, 8, 11)), ((13, 16, 18, 20), (14, 17, 19, 21))),
    "kit": Layout((1, 2, 3), (4,), ((16, 17, 18, 19, 20), (11, 12, 13, 14, 15)), ((8, 9, 10), (5, 6, 7))),
}
# Bone directions of an upright body with hanging arms, left side (the right one is its mirror image).
_HUMANML3D_DIRECTIONS = {
    1: (0.6, -0.8, -0.05), 4: (0.03, -1, 0), 7: (0, -1, 0), 10: (0.15, -0.42, 0.9), 3: (0, 1, -0.1), 6: (0, 1, 0.05),
    9: (0, 1, 0.05), 12: (0, 1, -0.1), 15: (0, 1, 0.4), 13: (0.6, 0.8, -0.1), 16: (0.95, 0.2, -0.1), 18: (0, -1, 0),
    20: (0, -1, 0),
}  # fmt: skip
# KIT's unit is about 0.6 of a millimetre (HUMANML3D_DATA §1), so these are offsets of a person of 1.75 m.
_KIT_OFFSETS = {
    1: (0, 55, 0), 2: (0, 95, -5), 3: (0, 150, 0), 4: (0, 95, 10), 8: (105, -30, 0), 9: (0, -165, 0), 10: (0, -150, 0),
    16: (52, -42, 0), 17: (0, -238, 0), 18: (0, -240, 0), 19: (8, -38, 70), 20: (4, 0, 42),
}  # fmt: skip


@dataclass(frozen=True)
class Body:
    """Hold a body of one skeleton: `offsets` (joints, 3) from each joint's parent when upright, in the skeleton's unit.

    Left and right limbs are equally long, so that a mirrored movement is the movement of the same body.
    """

    skeleton: Skeleton
    layout: Layout
    offsets: np.ndarray

    @classmethod
    def average(cls, skeleton: str) -> Body:
        """Make the body of the skeleton's usual proportions."""
        kind, layout = get_skeleton(skeleton), LAYOUTS[skeleton]
        offsets = np.zeros((kind.num_joints, 3))
        for joint, vector in (_HUMANML3D_DIRECTIONS if skeleton == "humanml3d" else _KIT_OFFSETS).items():
            offsets[joint] = vector
        if skeleton == "humanml3d":
            lengths = np.asarray(HUMANML3D.bone_lengths)
            partners = {a: b for limbs in (layout.legs, layout.arms) for a, b in zip(*limbs, strict=True)}
            for joint in _HUMANML3D_DIRECTIONS:
                length = (lengths[joint] + lengths[partners.get(joint, joint)]) / 2
                offsets[joint] *= length / np.linalg.norm(offsets[joint])
        for left, right in (*zip(*layout.legs, strict=True), *zip(*layout.arms, strict=True)):
            offsets[right] = offsets[left] * [-1, 1, 1]
        return cls(kind, layout, offsets)

    def varied(self, rng: np.random.Generator) -> Body:
        """Draw a body of another size and of other proportions of legs, trunk, arms and shoulders."""
        size = float(np.clip(rng.normal(1.0, 0.06), 0.85, 1.15))
        legs, trunk, arms, shoulders = np.clip(rng.normal(1.0, 0.035, 4), 0.9, 1.1)
        factor = np.full((len(self.offsets), 1), trunk)
        for leg in self.layout.legs:
            factor[list(leg)] = legs
        for arm in self.layout.arms:
            factor[list(arm)] = arms
            factor[list(arm[:-2])] = shoulders
        return Body(self.skeleton, self.layout, self.offsets * factor * size)

    @property
    def leg(self) -> float:
        """The length of thigh and shank, the unit of the tracks."""
        return float(np.linalg.norm(self.offsets[list(self.layout.legs[0][1:3])], axis=1).sum())


def rotation(axis: int, angle: np.ndarray | float) -> np.ndarray:
    """Make matrices (..., 3, 3) that turn about a coordinate axis by angle in radians."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.zeros((*np.shape(angle), 3, 3))
    matrix[..., axis, axis] = 1
    matrix[..., i, i] = matrix[..., j, j] = np.cos(angle)
    matrix[..., j, i] = np.sin(angle)
    matrix[..., i, j] = -matrix[..., j, i]
    return matrix


def bend(angles: np.ndarray) -> np.ndarray:
    """Turn pitch, twist, roll (..., 3) of a trunk segment into matrices (..., 3, 3)."""
    pitch, twist, roll = np.moveaxis(angles, -1, 0)
    return rotation(1, twist) @ rotation(0, pitch) @ rotation(2, -roll)


def pose(body: Body, tracks: Tracks) -> np.ndarray:
    """Return the joint positions (frames, joints, 3) of a body along tracks, in the skeleton's unit.

    Feet stand exactly where the tracks put them: where a leg is too short the hips come down.
    """
    offsets, layout = body.offsets, body.layout
    joints = np.zeros((tracks.frames, len(offsets), 3))
    pelvis = rotation(1, tracks.heading) @ bend(tracks.pelvis)
    ball = offsets[layout.legs[0][3]]
    joints[:, 0] = tracks.root * body.leg
    joints[:, 0, 1] -= ball[1] + offsets[layout.legs[0][0], 1]
    feet = [_foot(body, side, tracks.feet[:, side]) for side in (0, 1)]
    joints[:, 0, 1] -= _drop(body, joints[:, 0], pelvis, [ankle for ankle, *_ in feet])
    for side in (0, 1):
        _leg(body, joints, side, pelvis, *feet[side])
    chest, parent, share = pelvis, 0, bend(tracks.spine / len(layout.spine))
    for joint in layout.spine:
        chest = chest @ share
        joints[:, joint] = joints[:, parent] + chest @ offsets[joint]
        parent = joint
    neck, above = chest @ bend(tracks.head), parent
    for joint in layout.head:
        joints[:, joint] = joints[:, above] + neck @ offsets[joint]
        above = joint
    for side in (0, 1):
        _arm(body, joints, side, chest, tracks.arms[:, side])
    return joints


def _foot(body: Body, side: int, foot: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the ankle position, the rotation of the foot and that of its floor plan."""
    ball = body.offsets[body.layout.legs[side][3]]
    plan = rotation(1, foot[:, 3])
    turn = plan @ rotation(0, foot[:, 4])
    planted = foot[:, :3] * body.leg + plan @ (ball * [1, 0, 1])
    return planted - turn @ ball, turn, plan


def _drop(body: Body, root: np.ndarray, pelvis: np.ndarray, ankles: list[np.ndarray]) -> np.ndarray:
    """Say how far the root must come down so that both legs reach, as a smooth maximum."""
    reach, sharpness, excess = 0.995 * body.leg, 40 / body.leg, [np.zeros(len(root))]
    for leg, ankle in zip(body.layout.legs, ankles, strict=True):
        gap = root + pelvis @ body.offsets[leg[0]] - ankle
        flat = np.square(gap[:, [0, 2]]).sum(1)
        excess.append(gap[:, 1] - np.sqrt(np.maximum(reach**2 - flat, (0.2 * reach) ** 2)))
    return np.logaddexp.reduce(np.stack(excess) * sharpness, axis=0) / sharpness


def _leg(
    body: Body, joints: np.ndarray, side: int, pelvis: np.ndarray, ankle: np.ndarray, turn: np.ndarray, plan: np.ndarray
) -> None:
    hip, knee, foot, ball, *toes = body.layout.legs[side]
    thigh, shank = (float(np.linalg.norm(body.offsets[j])) for j in (knee, foot))
    joints[:, hip] = joints[:, 0] + pelvis @ body.offsets[hip]
    gap = ankle - joints[:, hip]
    distance = np.linalg.norm(gap, axis=1, keepdims=True)
    along = gap / distance
    distance = np.clip(distance, 1.05 * abs(thigh - shank) + 0.1 * shank, 0.9995 * (thigh + shank))
    forward = np.cross(along, pelvis[:, :, 0] + plan[:, :, 0])
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    near = (thigh**2 - shank**2 + distance**2) / (2 * distance)
    joints[:, knee] = joints[:, hip] + near * along + np.sqrt(np.maximum(thigh**2 - near**2, 0)) * forward
    joints[:, foot] = joints[:, hip] + distance * along
    joints[:, ball] = joints[:, foot] + turn @ body.offsets[ball]
    for before, toe in zip([ball, *toes], toes, strict=False):
        joints[:, toe] = joints[:, before] + plan @ body.offsets[toe]


def _arm(body: Body, joints: np.ndarray, side: int, chest: np.ndarray, arm: np.ndarray) -> None:
    sign = 1 - 2 * side
    swing, out, across, twist, elbow = arm.T
    upper = chest @ rotation(1, -sign * across) @ rotation(2, sign * out) @ rotation(0, -swing)
    lower = upper @ rotation(1, sign * twist) @ rotation(0, -elbow)
    *trunk, bent, hand = body.layout.arms[side]
    parent = body.layout.spine[-1]
    for joint, frame in [*((j, chest) for j in trunk), (bent, upper), (hand, lower)]:
        joints[:, joint] = joints[:, parent] + frame @ body.offsets[joint]
        parent = joint

"""Fit rotations to joint positions: an inverse kinematics that is analytic, batched over frames and continuous.

Bones keep their lengths (the clip's medians). Joints with several children (pelvis, chest) turn as their children do
(Kabsch); a bone with one child is swung from its rest to where the child is; upper arms and thighs are twisted so that
elbows and knees bend the way they do, the spine so that it takes the chest's turn in parts.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.linalg import solveh_banded
from scipy.spatial.transform import Rotation

from kinema.motion.captures.capture import Capture
from kinema.motion.kinematics import bone_lengths, bone_vectors
from kinema.motion.rig.pose import RestPose
from kinema.motion.rotation import shortest_arc, unit

ROUNDS = 3
"""Rounds in which the shape of a joint with several children settles."""
STIFF, FREE = 1.0, 0.02
"""How much a twist minds changing between frames, and another one than the least turn's: a right-angled bend has 1."""


def fit_rig(joints: Float[np.ndarray, "t j 3"], rest: RestPose, fps: float) -> Capture:
    """Turn positions (Y up) into rotations of the T-posed skeleton; the root moves as the pelvis does."""
    joints = np.asarray(joints, dtype=np.float64)
    return _Fit(joints, rest, fps).capture()


class _Fit:
    def __init__(self, joints: Float[np.ndarray, "t j 3"], rest: RestPose, fps: float) -> None:
        self.joints, self.rest, self.fps = joints, rest, fps
        self.vectors = bone_vectors(joints, rest.skeleton)
        lengths = np.median(bone_lengths(joints, rest.skeleton), axis=0)
        self.offsets = rest.directions * lengths[:, None]
        self.turned = np.tile(np.eye(3), (len(joints), len(lengths), 1, 1))
        self.placed = np.empty_like(joints)
        self.branching = [j for j, children in enumerate(rest.children) if len(children) > 1]

    def capture(self) -> Capture:
        """Solve joint by joint, then write turns relative to parents."""
        parents, names = self.rest.skeleton.parents, self.rest.skeleton.joint_names
        for joint in self.branching:
            self.turned[:, joint] = self._settled(joint)
        self.placed[:, 0] = self.joints[:, 0]
        for joint in self.rest.order[1:]:
            parent = parents[joint]
            way = np.einsum("tij,j->ti", self.turned[:, parent], self.offsets[joint])
            self.placed[:, joint] = self.placed[:, parent] + way
            if joint not in self.branching:
                self.turned[:, joint] = self._turn(joint)
        local = self.turned.copy()
        for joint, parent in enumerate(parents):
            if parent >= 0:
                local[:, joint] = np.swapaxes(self.turned[:, parent], -1, -2) @ self.turned[:, joint]
        translations = np.tile(self.offsets, (len(self.joints), 1, 1))
        translations[:, 0] = self.joints[:, 0]
        return Capture(names, parents, local, translations, self._standing(), self.fps)

    def _standing(self) -> Float[np.ndarray, "j 3"]:
        """The rest pose with its feet on the floor."""
        heights = self.rest.skeleton.ancestry @ self.offsets[:, 1]
        standing = self.offsets.copy()
        standing[0] = [0, -heights.min(), 0]
        return standing

    def _settled(self, joint: int) -> Float[np.ndarray, "t 3 3"]:
        """Turn a joint as its children lie, whose shape at rest is the mean of the clip's."""
        children = list(self.rest.children[joint])
        seen, shape = self.vectors[:, children], self.offsets[children]
        for _ in range(ROUNDS):
            turns = _kabsch(shape, seen)
            lengths = np.linalg.norm(shape, axis=-1, keepdims=True)
            mean = np.einsum("tji,tkj->ki", turns, seen)
            # The mean shape, turned to lie as the T-pose's does.
            back = _kabsch(mean, self.offsets[None, children])[0]
            shape = unit(mean @ back.T) * lengths
        self.offsets[children] = shape
        return _kabsch(shape, seen)

    def _turn(self, joint: int) -> Float[np.ndarray, "t 3 3"]:
        """Swing a joint's bone to its child and twist it; a joint without a child goes with its parent."""
        base = self.turned[:, self.rest.skeleton.parents[joint]]
        if not self.rest.children[joint]:
            return base
        (child,) = self.rest.children[joint]
        way = unit(self.joints[:, child] - self.placed[:, joint])
        inside = np.einsum("tji,tj->ti", base, way)
        swung = base @ _swing(self.rest, joint, child, inside)
        hinged = joint in self.rest.hinges
        angles = self._bend(joint, child, base, swung, way) if hinged else self._share(joint, child, swung, way)
        return swung if angles is None else Rotation.from_rotvec(angles[:, None] * way).as_matrix() @ swung

    def _bend(
        self,
        joint: int,
        child: int,
        base: Float[np.ndarray, "t 3 3"],
        swung: Float[np.ndarray, "t 3 3"],
        way: Float[np.ndarray, "t 3"],
    ) -> Float[np.ndarray, " t"]:
        """Find the twist by which a hinge bends to its side.

        Where the limb is straight, the frames around decide and, far from where it has no axis, the least turn.
        """
        side = self.rest.hinges[joint]
        (end,) = self.rest.children[child]
        bone = unit(self.vectors[:, end])
        bent = bone - np.einsum("ti,ti->t", bone, way)[:, None] * way
        inside = np.einsum("tji,tj->ti", base, way)
        least = base @ shortest_arc(self.rest.directions[child][None], inside)
        aim = swung @ side
        across = np.cross(way, aim)
        seen, usual = (_plane(vectors, aim, across) for vectors in (bent, least @ side))
        share = FREE * ((1 + inside @ self.rest.directions[child]) / 2) ** 2
        return np.unwrap(np.angle(_smooth(seen * np.abs(seen) + usual * share, np.abs(seen) ** 2 + share)))

    def _share(
        self, joint: int, child: int, swung: Float[np.ndarray, "t 3 3"], way: Float[np.ndarray, "t 3"]
    ) -> Float[np.ndarray, " t"] | None:
        """Find a bone's share of the twist to the next joint whose turn is known, along a chain of single children."""
        ahead, bones = child, 1
        while ahead not in self.branching:
            if len(self.rest.children[ahead]) != 1:
                return None
            (ahead,) = self.rest.children[ahead]
            bones += 1
        left = self.turned[:, ahead] @ np.swapaxes(swung, -1, -2)
        quaternions = Rotation.from_matrix(left).as_quat()
        along = np.einsum("ti,ti->t", quaternions[:, :3], way)
        return np.unwrap(2 * np.arctan2(along, quaternions[:, 3]), period=2 * np.pi) / (bones + 1)


def _swing(rest: RestPose, joint: int, child: int, way: Float[np.ndarray, "t 3"]) -> Float[np.ndarray, "t 3 3"]:
    """Turn a bone from its rest to `way`, both in the parent's frame: by the least angle, through its reach."""
    start = rest.directions[child]
    middle = rest.reach.get(joint, start)
    return shortest_arc(middle[None], way) @ shortest_arc(start[None], middle[None])


def _kabsch(shape: Float[np.ndarray, "k 3"], seen: Float[np.ndarray, "t k 3"]) -> Float[np.ndarray, "t 3 3"]:
    """Find the rotations that bring a shape nearest to each of the seen ones."""
    u, _, v = np.linalg.svd(np.einsum("tki,kj->tij", seen, shape))
    u[:, :, 2] *= np.sign(np.linalg.det(u @ v))[:, None]
    return u @ v


def _plane(
    vectors: Float[np.ndarray, "t 3"], first: Float[np.ndarray, "t 3"], second: Float[np.ndarray, "t 3"]
) -> np.ndarray:
    """Write vectors as complex numbers of the plane that two directions span."""
    return np.einsum("ti,ti->t", vectors, first) + 1j * np.einsum("ti,ti->t", vectors, second)


def _smooth(seen: np.ndarray, weights: Float[np.ndarray, " t"]) -> np.ndarray:
    """Smooth directions of the plane (complex, times their weights)."""
    size = len(weights)
    if size == 1:
        return seen / weights
    bands = np.zeros((2, size))
    bands[1] = weights
    bands[1, 1:] += STIFF
    bands[1, :-1] += STIFF
    bands[0, 1:] = -STIFF
    return solveh_banded(bands, np.stack([seen.real, seen.imag], 1)) @ np.array([1, 1j])

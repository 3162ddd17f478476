"""Describe a movement without a body: channels over time, in leg lengths and radians.

Axes are those of HumanML3D: Y up, facing +Z, left = +X; a positive yaw turns left (counterclockwise from above).
Sides are indexed 0 = left, 1 = right; side-wise angles are positive outwards, so that both sides read alike.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

RAD = np.pi / 180
STANDING = 0.98
"""Height of the hips over the ankles in leg lengths when standing at ease."""
FOOT_X = 0.1
"""Half the distance of the feet when standing at ease, in leg lengths."""
TOE_OUT = 8 * RAD
"""How far the feet point outwards."""
ARM = ("swing", "out", "across", "twist", "elbow")
FOOT = ("x", "lift", "z", "yaw", "heel")


def smooth(x: np.ndarray | float) -> np.ndarray:
    """Rise from 0 to 1 while x does, with no speed and no acceleration at either end."""
    x = np.clip(x, 0.0, 1.0)
    return x * x * x * (10 - 15 * x + 6 * x * x)


def pulse(u: np.ndarray, rise: float = 0.5, fall: float = 0.5) -> np.ndarray:
    """Rise from 0 to 1 in the first `rise` of u in [0, 1], hold, and fall back to 0 in the last `fall`."""
    return smooth(u / rise) * smooth((1 - u) / fall)


@dataclass
class Tracks:
    """Hold the channels of a movement; everything is stated relative to a flat floor at height 0.

    root (t, 3): x, hip height over the flat ankle, z. heading (t,): yaw of the facing.
    pelvis, spine, head (t, 3): pitch (+ forward), twist (+ left), roll (+ left), each relative to what it sits on.
    feet (t, 2, 5): x, lift, z of the spot under the flat ankle, yaw, pitch about the ball (+ heel up).
    arms (t, 2, 5): swing (+ forward), out (+ sideways), across (+ inwards), twist (+ outwards), elbow bend.
    """

    fps: float
    root: np.ndarray
    heading: np.ndarray
    pelvis: np.ndarray
    spine: np.ndarray
    head: np.ndarray
    feet: np.ndarray
    arms: np.ndarray

    @classmethod
    def stand(cls, frames: int, fps: float) -> Tracks:
        """Stand at ease at the origin."""
        root = np.tile([0.0, STANDING, 0.0], (frames, 1))
        feet = np.zeros((frames, 2, 5))
        feet[:, :, 0] = [FOOT_X, -FOOT_X]
        feet[:, :, 3] = [TOE_OUT, -TOE_OUT]
        arms = np.tile(np.array([0.0, 9.0, 0.0, 0.0, 14.0]) * RAD, (frames, 2, 1))
        pelvis, spine, head = (np.zeros((frames, 3)) for _ in range(3))
        return cls(fps, root, np.zeros(frames), pelvis, spine, head, feet, arms)

    @property
    def frames(self) -> int:
        """Count the frames."""
        return len(self.heading)

    @property
    def time(self) -> np.ndarray:
        """The seconds at each frame."""
        return np.arange(self.frames) / self.fps

    def arm(self, side: int, amount: np.ndarray, **degrees: float | np.ndarray) -> None:
        """Move an arm towards a posture, by the share `amount` at each frame."""
        for name, value in degrees.items():
            channel = self.arms[:, side, ARM.index(name)]
            channel += amount * (np.multiply(value, RAD) - channel)

    def foot(self, side: int, amount: np.ndarray, **target: float | np.ndarray) -> None:
        """Move a foot by leg lengths (x, lift, z) and degrees (yaw, heel), each times the share `amount`."""
        for name, value in target.items():
            channel = FOOT.index(name)
            self.feet[:, side, channel] += amount * (np.multiply(value, RAD) if channel > 2 else value)

    def trunk(
        self, amount: np.ndarray, *, lean: float = 0, twist: float = 0, roll: float = 0, hips: float = 0.3
    ) -> None:
        """Bend the trunk forward, to the left (twist) and sideways to the left (roll) by degrees times `amount`.

        The share `hips` of it happens in the pelvis.
        """
        angles = amount[:, None] * np.array([lean, twist, roll]) * RAD
        self.pelvis += hips * angles
        self.spine += (1 - hips) * angles

    def hips(self, amount: np.ndarray, *, drop: float = 0, x: float = 0, z: float = 0) -> None:
        """Lower the hips and shift them, by leg lengths times `amount`, in the directions of the world."""
        self.root += amount[:, None] * np.array([x, -drop, z])

    def mirrored(self) -> Tracks:
        """Swap left and right."""
        flip = np.array([1.0, -1.0, -1.0])
        return replace(
            self,
            root=self.root * [-1, 1, 1],
            heading=-self.heading,
            pelvis=self.pelvis * flip,
            spine=self.spine * flip,
            head=self.head * flip,
            feet=self.feet[:, ::-1] * [-1, 1, 1, -1, 1],
            arms=self.arms[:, ::-1],
        )

    def moved(self, x: float, z: float, yaw: float) -> Tracks:
        """Turn about the origin by yaw, then shift on the floor."""
        c, s = np.cos(yaw), np.sin(yaw)
        root, feet = self.root.copy(), self.feet.copy()
        for points in (root, feet):
            px, pz = points[..., 0].copy(), points[..., 2].copy()
            points[..., 0], points[..., 2] = c * px + s * pz + x, -s * px + c * pz + z
        feet[..., 3] += yaw
        return replace(self, root=root, feet=feet, heading=self.heading + yaw)

    def then(self, other: Tracks, overlap: int) -> Tracks:
        """Append a movement that starts standing where this one ends standing, fading over `overlap` frames."""
        spot = self.feet[-1].mean(0)
        other = other.moved(spot[0], spot[2], float(self.heading[-1]))
        weight = smooth(np.linspace(0, 1, overlap + 2)[1:-1])
        joined = {}
        for f in fields(self)[1:]:
            a, b = getattr(self, f.name), getattr(other, f.name)
            w = weight.reshape(-1, *[1] * (a.ndim - 1))
            joined[f.name] = np.concatenate([a[:-overlap], (1 - w) * a[-overlap:] + w * b[:overlap], b[overlap:]])
        return Tracks(self.fps, **joined)

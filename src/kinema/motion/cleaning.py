"""Hold the feet of a motion, of its joints and its feature rows alike, and say what that changes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float

from kinema.motion import physics
from kinema.motion.feet import contacts, drift, legs, lock_feet
from kinema.motion.lifting import lift
from kinema.motion.recovery import recover_joints, recover_root
from kinema.motion.rotation import rotate_yaw
from kinema.motion.skeleton import Skeleton, get_skeleton
from kinema.types import Motion


def lock_rows(features: Float[np.ndarray, "t w"], skeleton: Skeleton) -> Float[np.ndarray, "t w"]:
    """Return rows of one motion with feet that stand held still.

    Of the essential columns the legs' positions change alone: root and heading stay. Redundant columns, where there
    are any, are recomputed from the joints (`lift`). A single frame stays as it is.
    """
    if len(features) < 2:
        return features
    rows = torch.from_numpy(features.astype(np.float64))
    held = lock_feet(recover_joints(rows, skeleton).numpy(), skeleton, skeleton.fps)
    yaw, root = (part.numpy() for part in recover_root(rows))
    local = rotate_yaw(held - root[:, None] * (1, 0, 1), yaw)
    moved = [joint for leg in legs(skeleton) for joint in (leg.knee, leg.ankle, leg.toe)]
    known = features[:, : skeleton.essential_width].copy()
    joints = known[:, skeleton.groups["joints"]].reshape(len(known), -1, 3)
    joints[:, [joint - 1 for joint in moved]] = local[:, moved]
    known[:, skeleton.groups["joints"]] = joints.reshape(len(known), -1)
    return known if features.shape[1] == skeleton.essential_width else lift(known, skeleton)


def floor_of(motion: Motion) -> float:
    """Return the height of the floor that a motion's rows are above, where its joints stand."""
    return float(motion.joints[0, 0, 1] - motion.features[0, 3])


@dataclass(frozen=True)
class Held:
    """Hold a motion whose feet were held, and its joints above the floor before and after."""

    motion: Motion
    before: np.ndarray
    after: np.ndarray

    @classmethod
    def of(cls, motion: Motion, floor: float) -> Held:
        """Hold the feet of a motion over a floor at that height, joints and rows; frames that an edit kept too."""
        skeleton = get_skeleton(motion.skeleton)
        raised = np.array([0, floor, 0], dtype=np.float32)
        before = motion.joints - raised
        after = lock_feet(before, skeleton, motion.fps).astype(np.float32)
        made = replace(motion, joints=after + raised, features=lock_rows(motion.features, skeleton))
        return cls(made, before, after)

    def figures(self, joints: Float[np.ndarray, "t j 3"]) -> dict[str, float]:
        """Measure joints in its frames: skating (%), drift of contacts (cm), jitter (m/s^3), penetration (mm)."""
        skeleton = get_skeleton(self.motion.skeleton)
        batch, length = torch.as_tensor(joints)[None], torch.tensor([len(joints)])
        toes = [leg.toe for leg in legs(skeleton)]
        standing = [contacts(self.before[:, toe] * skeleton.meters, self.motion.fps) for toe in toes]
        found = [away for toe, when in zip(toes, standing, strict=True) for away in drift(joints[:, toe], when)]
        return {
            "skating": 100 * float(physics.foot_skating(batch, length, skeleton)),
            "drift": 100 * skeleton.meters * float(np.mean(found or [0.0])),
            "jitter": float(physics.jitter(batch, length, self.motion.fps, skeleton.unit)),
            "penetration": float(physics.floor_distances(batch, length, skeleton)[1]),
        }

    @property
    def farthest(self) -> float:
        """How far a joint moved at most, in cm."""
        moved = np.linalg.norm(self.after - self.before, axis=-1).max()
        return 100 * get_skeleton(self.motion.skeleton).meters * float(moved)


UNITS = {"skating": "%", "drift": "cm", "jitter": "m/s3", "penetration": "mm"}


def described(held: Sequence[Held]) -> str:
    """Say what holding the feet of motions changed: means over them, and the farthest that a joint moved."""
    before, after = [one.figures(one.before) for one in held], [one.figures(one.after) for one in held]

    def mean(figures: list[dict[str, float]], name: str) -> float:
        return float(np.mean([one[name] for one in figures]))

    said = [f"{name} {mean(before, name):.1f} -> {mean(after, name):.1f} {unit}" for name, unit in UNITS.items()]
    return f"{', '.join(said)}; no joint moved by more than {max(one.farthest for one in held):.1f} cm"

"""Describe the two skeletons of the field: HumanML3D (SMPL, 22 joints) and KIT-ML (MMM, 21 joints).

Right-handed, Y up, canonical facing +Z, the character's left at +X. Source: HUMANML3D_DATA §1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

DIMS = ("essential", "redundant")
"""Which columns of a feature row: those that joints are recovered from, which come first, or all."""


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Hold joints, chains and constants of one skeleton; lengths are in `unit`.

    `chains` start at a joint of an earlier chain. `face_joints` are (right hip, left hip, right shoulder, left
    shoulder). `contact_threshold` bounds a foot's squared displacement per frame. `leg_joints` are knee and ankle of
    one leg: their bones scale the root path. `rest_directions` has one unit vector per joint, from its parent in the
    rest pose (zero for the root); `bone_lengths` the target lengths, zero for the root. A clip enters the corpus if
    it has `min_frames` <= rows < `max_frames`. `mirror_pairs` are (left, right). `leg_length` is that of a usual body,
    its `leg_joints` together.
    """

    name: str
    joint_names: tuple[str, ...]
    parents: tuple[int, ...]
    chains: tuple[tuple[int, ...], ...]
    face_joints: tuple[int, int, int, int]
    feet_left: tuple[int, int]
    feet_right: tuple[int, int]
    contact_threshold: float
    leg_joints: tuple[int, int]
    rest_directions: np.ndarray
    bone_lengths: np.ndarray | None
    fps: float
    unit: str
    min_frames: int
    max_frames: int
    mirror_pairs: tuple[tuple[int, int], ...]
    leg_length: float

    @property
    def num_joints(self) -> int:
        """Count the joints J, the root included."""
        return len(self.joint_names)

    @property
    def feature_width(self) -> int:
        """The width of the full (redundant) feature row: 12 J - 1."""
        return self.groups["contacts"].stop

    @property
    def essential_width(self) -> int:
        """The width of the essential part, root and joint positions: 3 J + 1 (MARDM §1)."""
        return self.groups["joints"].stop

    def width_of(self, dims: str) -> int:
        """Count the columns of `dims`; raises ValueError for what isn't one of `DIMS`."""
        if dims not in DIMS:
            raise ValueError(f"unknown dims {dims!r}; choose one of {', '.join(DIMS)}")
        return self.essential_width if dims == "essential" else self.feature_width

    @cached_property
    def groups(self) -> dict[str, slice]:
        """Name the seven column groups of a feature row, in order (HUMANML3D_DATA §3.11)."""
        bones = self.num_joints - 1
        widths = {
            "root_yaw": 1,
            "root_linear": 2,
            "root_height": 1,
            "joints": 3 * bones,
            "rotations": 6 * bones,
            "velocities": 3 * self.num_joints,
            "contacts": 4,
        }
        ends = np.cumsum(list(widths.values())).tolist()
        return {name: slice(end - width, end) for (name, width), end in zip(widths.items(), ends, strict=True)}

    @cached_property
    def rotation_parents(self) -> tuple[int, ...]:
        """The joint whose orientation a rotation feature is relative to: 0, the heading, at every chain's start.

        The arm chains hang on the heading too, not on the spine they start from (a quirk, HUMANML3D_DATA §3.9).
        """
        parents = list(self.parents)
        for chain in self.chains:
            parents[chain[1]] = 0
        return tuple(parents)

    @cached_property
    def ancestry(self) -> np.ndarray:
        """The (J, J) matrix with 1 where bone k lies on the path from the root to joint j (root bone excluded)."""
        paths = np.zeros((self.num_joints, self.num_joints))
        for chain in self.chains:
            for parent, child in pairwise(chain):
                paths[child] = paths[parent]
                paths[child, child] = 1
        paths.setflags(write=False)
        return paths

    @property
    def meters(self) -> float:
        """The factor from `unit` to metres."""
        return {"m": 1.0, "mm": 1e-3}[self.unit]


def get_skeleton(name: str) -> Skeleton:
    """Find a skeleton by its name."""
    if name not in SKELETONS:
        raise ValueError(f"unknown skeleton {name!r}; choose one of {', '.join(sorted(SKELETONS))}")
    return SKELETONS[name]


def _parents(chains: tuple[tuple[int, ...], ...]) -> tuple[int, ...]:
    """Read the parent of every joint from the chains; the root's is -1."""
    found = {child: parent for chain in chains for parent, child in pairwise(chain)}
    return tuple(found.get(joint, -1) for joint in range(len(found) + 1))


def _names(*lines: str) -> tuple[str, ...]:
    return tuple(" ".join(lines).split())


def _directions(axes: str) -> np.ndarray:
    """Read rest directions such as "+X -Y": one per joint from joint 1 on; the root's is zero."""
    unit = {"X": (1, 0, 0), "Y": (0, 1, 0), "Z": (0, 0, 1)}
    rows = [np.multiply(unit[a[1]], int(a[0] + "1")) for a in axes.split()]
    return _frozen((0, 0, 0), *rows)


def _frozen(*values: object) -> np.ndarray:
    array = np.asarray(values, dtype=np.float64)
    array.setflags(write=False)
    return array


_HUMANML3D_CHAINS = (
    (0, 2, 5, 8, 11),
    (0, 1, 4, 7, 10),
    (0, 3, 6, 9, 12, 15),
    (9, 14, 17, 19, 21),
    (9, 13, 16, 18, 20),
)

HUMANML3D = Skeleton(
    name="humanml3d",
    joint_names=_names(
        "pelvis left_hip right_hip spine1 left_knee right_knee spine2 left_ankle right_ankle spine3 left_foot",
        "right_foot neck left_collar right_collar head left_shoulder right_shoulder left_elbow right_elbow",
        "left_wrist right_wrist",
    ),
    parents=_parents(_HUMANML3D_CHAINS),
    chains=_HUMANML3D_CHAINS,
    face_joints=(2, 1, 17, 16),
    feet_left=(7, 10),
    feet_right=(8, 11),
    contact_threshold=0.002,
    leg_joints=(5, 8),
    rest_directions=_directions("+X -X +Y -Y -Y +Y -Y -Y +Y +Z +Z +Y +X -X +Z -Y -Y -Y -Y -Y -Y"),
    # Frame 0 of clip 000021, the published target (HUMANML3D_DATA §1).
    bone_lengths=_frozen(
        *(0, 0.103074, 0.109883, 0.131568, 0.393623, 0.390188, 0.143190, 0.432433, 0.425643, 0.057365, 0.143382),
        *(0.149419, 0.219360, 0.137487, 0.143383, 0.103039, 0.131614, 0.122984, 0.256840, 0.263092, 0.266012, 0.269876),
    ),
    fps=20.0,
    unit="m",
    min_frames=40,
    max_frames=200,
    mirror_pairs=((1, 2), (4, 5), (7, 8), (10, 11), (13, 14), (16, 17), (18, 19), (20, 21)),
    leg_length=0.815831,
)

_KIT_CHAINS = (
    (0, 11, 12, 13, 14, 15),
    (0, 16, 17, 18, 19, 20),
    (0, 1, 2, 3, 4),
    (3, 5, 6, 7),
    (3, 8, 9, 10),
)

KIT = Skeleton(
    name="kit",
    joint_names=_names(
        "pelvis spine chest neck head right_shoulder right_elbow right_wrist left_shoulder left_elbow left_wrist",
        "right_hip right_knee right_ankle right_midfoot right_toe left_hip left_knee left_ankle left_midfoot left_toe",
    ),
    parents=_parents(_KIT_CHAINS),
    chains=_KIT_CHAINS,
    face_joints=(11, 16, 5, 8),
    feet_left=(19, 20),
    feet_right=(14, 15),
    contact_threshold=0.05,
    leg_joints=(17, 18),
    rest_directions=_directions("+Y +Y +Y +Y +X -Y -Y -X -Y -Y +X -Y -Y +Z +Z -X -Y -Y +Z +Z"),
    bone_lengths=None,
    fps=12.5,
    unit="mm",
    min_frames=24,
    max_frames=200,
    mirror_pairs=((8, 5), (9, 6), (10, 7), (16, 11), (17, 12), (18, 13), (19, 14), (20, 15)),
    # KIT's unit is about 0.6 of a millimetre (HUMANML3D_DATA §1): its mean root height is 559.6.
    leg_length=478.0,
)

SKELETONS = {skeleton.name: skeleton for skeleton in (HUMANML3D, KIT)}

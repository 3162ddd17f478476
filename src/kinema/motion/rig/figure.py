"""Build a simple figure around a rig: a body of rounded limbs, so that an exported motion shows in any viewer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from kinema.motion.rotation import unit
from kinema.motion.skeleton import Skeleton

SIDES, CAP = 12, 3
"""Corners of a limb's cross-section, and rings of each of its rounded ends."""

LIMBS = (
    ("left_hip", "left_knee", 0.078, 0.055),
    ("left_knee", "left_ankle", 0.054, 0.038),
    ("left_ankle", "left_foot", 0.042, 0.036),
    ("left_shoulder", "left_elbow", 0.047, 0.038),
    ("left_elbow", "left_wrist", 0.038, 0.028),
    ("left_collar", "left_shoulder", 0.055, 0.05),
    ("pelvis", "left_hip", 0.095, 0.085),
    ("pelvis", "spine1", 0.115, 0.11),
    ("spine1", "spine2", 0.11, 0.115),
    ("spine2", "spine3", 0.115, 0.12),
    ("spine3", "neck", 0.12, 0.06),
    ("spine3", "left_collar", 0.1, 0.07),
    ("neck", "head", 0.052, 0.05),
)
"""Start, end and the radii there in metres, for a body of `STATURE`; left ones stand for both."""
TIPS = (
    ("head", (0, 0.1, 0.015), 0.07, 0.098),
    ("left_wrist", (0.11, 0, 0), 0.03, 0.024),
    ("left_foot", (0, 0, 0.06), 0.035, 0.028),
)
"""Parts beyond the last joints: where they end (of the T-pose), and the radii."""
STATURE = 1.7


@dataclass(frozen=True)
class Figure:
    """Hold a mesh in the rest pose: vertices (V, 3) in metres, normals, triangles (F, 3), and whose bone each is on."""

    vertices: Float[np.ndarray, "v 3"]
    normals: Float[np.ndarray, "v 3"]
    triangles: Int[np.ndarray, "f 3"]
    joints: Int[np.ndarray, " v"]


def build_figure(rest: Float[np.ndarray, "j 3"], skeleton: Skeleton) -> Figure:
    """Lay limbs around the bones of a T-pose (positions in metres), as thick as the body is tall."""
    index = {name: i for i, name in enumerate(skeleton.joint_names)}
    size = float(np.ptp(rest[:, 1])) / STATURE
    parts = []
    for start, end, thick, thin in LIMBS:
        for first, second in sorted({(start, end), (_right(start), _right(end))}):
            parts.append((index[first], _limb(rest[index[first]], rest[index[second]], thick * size, thin * size)))
    for name, way, thick, thin in TIPS:
        for side in sorted({name, _right(name)}):
            way_there = np.array(way) * ([-1, 1, 1] if side != name else [1, 1, 1]) * size
            start = rest[index[side]]
            parts.append((index[side], _limb(start, start + way_there, thick * size, thin * size)))
    counts = np.cumsum([0, *(len(vertices) for _, (vertices, _, _) in parts)])
    return Figure(
        np.concatenate([vertices for _, (vertices, _, _) in parts]),
        np.concatenate([normals for _, (_, normals, _) in parts]),
        np.concatenate([faces + first for (_, (_, _, faces)), first in zip(parts, counts, strict=False)]),
        np.concatenate([np.full(len(vertices), joint) for joint, (vertices, _, _) in parts]),
    )


def _right(name: str) -> str:
    return name.replace("left_", "right_")


def _limb(
    start: Float[np.ndarray, " 3"], end: Float[np.ndarray, " 3"], thick: float, thin: float
) -> tuple[Float[np.ndarray, "v 3"], Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Build a rounded limb: vertices, normals, triangles seen from outside."""
    axis = unit(end - start)
    across = unit(np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))]))
    frame = np.stack([across, np.cross(axis, across)])
    angles = np.linspace(0, 2 * np.pi, SIDES, endpoint=False)
    round_about = np.stack([np.cos(angles), np.sin(angles)], 1) @ frame
    rise = np.linspace(-np.pi / 2, 0, CAP + 1)
    rings = [(start, thick, angle) for angle in rise] + [(end, thin, -angle) for angle in rise[::-1]]
    normals = np.concatenate([np.cos(a) * round_about + np.sin(a) * axis for _, _, a in rings])
    centres = np.repeat([centre for centre, _, _ in rings], SIDES, axis=0)
    radii = np.repeat([radius for _, radius, _ in rings], SIDES)[:, None]
    corner = np.arange(SIDES)
    nxt = (corner + 1) % SIDES
    faces = []
    for ring in range(len(rings) - 1):
        below, above = ring * SIDES, (ring + 1) * SIDES
        faces += [np.stack([below + corner, below + nxt, above + nxt], 1)]
        faces += [np.stack([below + corner, above + nxt, above + corner], 1)]
    return centres + radii * normals, normals, np.concatenate(faces)

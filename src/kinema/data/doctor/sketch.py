"""Look at the joints of every clip of a corpus once, and keep what the checks need."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float

from kinema.data.doctor.patient import Patient
from kinema.motion.checks import Problem, check_clip
from kinema.motion.geometry import pace
from kinema.motion.recovery import recover_joints

POSES = 24
"""Poses of a clip that are compared, spread evenly over its time."""


@dataclass(frozen=True)
class Sketch:
    """Hold what is seen of each clip: poses in metres, flattened; greatest joint speed in m/s; median root height; pace
    (acceleration over speed, per frame); and the problems of its joints by kind.

    Poses are canonical: the first frame at the origin facing +Z, whatever the length of the clip.
    """

    poses: Float[np.ndarray, "n k"]
    speeds: Float[np.ndarray, " n"]
    heights: Float[np.ndarray, " n"]
    paces: Float[np.ndarray, " n"]
    problems: list[dict[str, Problem]]


def sketch(patient: Patient) -> Sketch:
    """Look at every clip's joints, as they are recovered from its features."""
    skeleton, count = patient.skeleton, len(patient)
    poses = np.empty((count, POSES * skeleton.num_joints * 3), dtype=np.float32)
    speeds, heights, paces = np.empty(count), np.empty(count), np.empty(count)
    problems = []
    for i in range(count):
        rows = torch.from_numpy(np.array(patient.rows(i)[:, : skeleton.essential_width]))
        joints = recover_joints(rows, skeleton).numpy()
        chosen = np.linspace(0, len(joints) - 1, POSES).round().astype(int)
        poses[i] = joints[chosen].reshape(-1) * skeleton.meters
        steps = np.linalg.norm(np.diff(joints, axis=0), axis=-1)
        speeds[i] = steps.max(initial=0) * skeleton.meters * skeleton.fps
        heights[i] = np.median(joints[:, 0, 1])
        paces[i] = pace(joints)
        problems.append({p.kind: p for p in check_clip(joints, skeleton, skeleton.fps, patient.convention)})
    return Sketch(poses, speeds, heights, paces, problems)

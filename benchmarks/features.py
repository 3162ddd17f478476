"""Measure feature extraction: frames per second on one core, and the ratio to a frame-by-frame loop in the same run.

    python benchmarks/features.py [--clips 200] [--joints FOLDER]

Clips are random walks, or the (T, 22, 3) .npy files of FOLDER (a corpus' `joints/`). CPU time is counted, so a busy
machine does not matter. The loop computes the same rows (they are compared) one frame and one bone at a time.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from kinema.motion.features import canonicalise, extract, heading
from kinema.motion.kinematics import place_joints
from kinema.motion.rotation import unit
from kinema.motion.skeleton import HUMANML3D, Skeleton


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=int, default=200, help="number of random walks (default 200)")
    parser.add_argument("--joints", type=Path, help="folder of .npy joints to extract instead")
    arguments = parser.parse_args()
    clips = read_folder(arguments.joints) if arguments.joints else random_walks(arguments.clips)
    frames = sum(len(clip) for clip in clips)

    def vectorised(clip: np.ndarray) -> np.ndarray:
        return extract(clip, HUMANML3D, target_bone_lengths="skeleton")

    few = clips[:: max(1, len(clips) // 10)]
    seconds = cpu_seconds(vectorised, clips)
    # Both on the same few clips, one after the other: the ratio is free of the machine and of the corpus.
    fast, slow = cpu_seconds(vectorised, few), cpu_seconds(frame_by_frame, few)
    error = max(np.abs(vectorised(clip) - frame_by_frame(clip)).max() for clip in few)
    print(f"{len(clips)} clips, {frames} frames: {seconds:.2f} s of one core, {frames / seconds:,.0f} frames/s")
    print(f"frame by frame: {sum(map(len, few)) / slow:,.0f} frames/s; ratio {slow / fast:.1f}; difference {error:.1e}")


def cpu_seconds(function: Callable[[np.ndarray], np.ndarray], clips: list[np.ndarray]) -> float:
    """Time a pass over the clips, after one clip of warm-up."""
    function(clips[0])
    start = time.process_time()
    for clip in clips:
        function(clip)
    return time.process_time() - start


def frame_by_frame(clip: np.ndarray, skeleton: Skeleton = HUMANML3D) -> np.ndarray:
    """Extract the same rows with loops over frames and bones."""
    joints = canonicalise(retargeted(clip.astype(np.float64), skeleton), skeleton)
    yaw = heading(joints, skeleton)
    rows = []
    for t in range(len(joints) - 1):
        here, there, step = turn(yaw[t]), turn(yaw[t + 1]), joints[t + 1] - joints[t]
        increment = (yaw[t + 1] - yaw[t] + np.pi) % (2 * np.pi) - np.pi
        orientation, row = {0: here}, [increment / 2, *(there @ step[0])[[0, 2]], joints[t, 0, 1]]
        for j in range(1, skeleton.num_joints):
            row.extend(here @ (joints[t, j] - joints[t, 0] * (1, 0, 1)))
        rotations = {}
        for chain in skeleton.chains:
            previous = here
            for parent, child in pairwise(chain):
                bone = joints[t, child] - joints[t, parent]
                orientation[child] = arc(skeleton.rest_directions[child], bone / np.linalg.norm(bone))
                rotations[child] = previous.T @ orientation[child]
                previous = orientation[child]
        for j in range(1, skeleton.num_joints):
            row.extend([*rotations[j][:, 0], *rotations[j][:, 1]])
        for j in range(skeleton.num_joints):
            row.extend(here @ step[j])
        for j in (*skeleton.feet_left, *skeleton.feet_right):
            row.append(float(step[j] @ step[j] < skeleton.contact_threshold))
        rows.append(row)
    return np.array(rows, dtype=np.float32)


def retargeted(joints: np.ndarray, skeleton: Skeleton) -> np.ndarray:
    """Give a clip the skeleton's bone lengths, bone by bone."""
    knee, ankle = skeleton.leg_joints
    hip = skeleton.parents[knee]
    leg = np.linalg.norm(joints[0, knee] - joints[0, hip]) + np.linalg.norm(joints[0, ankle] - joints[0, knee])
    placed = joints * (skeleton.bone_lengths[knee] + skeleton.bone_lengths[ankle]) / leg
    for t in range(len(joints)):
        for chain in skeleton.chains:
            for parent, child in pairwise(chain):
                bone = joints[t, child] - joints[t, parent]
                placed[t, child] = placed[t, parent] + bone / np.linalg.norm(bone) * skeleton.bone_lengths[child]
    return placed


def turn(yaw: float) -> np.ndarray:
    """Make the matrix of a yaw about +Y."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])


def arc(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Make the matrix of the shortest arc between two unit vectors that are not opposite."""
    x, y, z = np.cross(source, target)
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + skew + skew @ skew / (1 + source @ target)


def random_walks(count: int, frames: int = 100) -> list[np.ndarray]:
    """Make clips whose bones and root walk at random."""
    rng = np.random.default_rng(0)
    clips = []
    for _ in range(count):
        sway = np.cumsum(rng.normal(scale=0.03, size=(frames, HUMANML3D.num_joints, 3)), axis=0)
        bones = unit(HUMANML3D.rest_directions + sway) * HUMANML3D.bone_lengths[:, None]
        path = np.cumsum(rng.normal(scale=0.01, size=(frames, 3)), axis=0)
        clips.append(place_joints(path, bones, HUMANML3D).astype(np.float32))
    return clips


def read_folder(folder: Path) -> list[np.ndarray]:
    """Read every clip of a joints folder."""
    files = sorted(folder.glob("*.npy"))
    if not files:
        sys.exit(f"no .npy files in {folder}; give a corpus' joints/ folder, or leave --joints out for random walks")
    return [np.load(file, allow_pickle=False) for file in files]


if __name__ == "__main__":
    main()

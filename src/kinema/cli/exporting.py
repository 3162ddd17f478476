"""Do what `kinema export` is asked: write a motion in another format, cleaned and changed for the tool it is for."""

from __future__ import annotations

import argparse
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import torch

from kinema.motion import export as write
from kinema.motion.convention import Convention
from kinema.motion.feet import lock_feet
from kinema.motion.physics import foot_skating
from kinema.motion.recording import read_recording
from kinema.motion.rig.changes import Changes
from kinema.motion.rig.fit import fit_rig
from kinema.motion.rig.pose import rest_pose
from kinema.motion.skeleton import Skeleton, get_skeleton
from kinema.types import Motion


def export(options: argparse.Namespace) -> None:
    """Write a motion in the format that the file's suffix names, and say how near rotations come to it."""
    told = Convention(**{field.name: getattr(options, field.name) for field in fields(Convention)})
    recording = read_recording(options.motion, told)
    print(f"read {recording.path}: {recording.note}")
    skeleton = recording.skeleton
    motion = recording.motion(skeleton, skeleton.essential_width)
    if options.lock_feet:
        motion = _standing(motion, skeleton)
    changes = Changes(options.rate, options.in_place, options.facing, options.loop, options.z_up)
    path = write.save(motion, options.out, changes)
    print(f"wrote {path}{_fit(motion) if Path(path).suffix in write.RIGGED else ''}")


def _standing(motion: Motion, skeleton: Skeleton) -> Motion:
    """Hold feet that stand, and say what that changed."""
    held = lock_feet(motion.joints, skeleton, motion.fps).astype(np.float32)
    before, after = (
        float(foot_skating(torch.as_tensor(j)[None], torch.tensor([len(j)]), skeleton)) for j in (motion.joints, held)
    )
    farthest = np.linalg.norm(held - motion.joints, axis=-1).max() * skeleton.meters
    print(
        f"feet      {before:.1%} of low frames slid, now {after:.1%}; a joint moved by {farthest * 100:.1f} cm at most"
    )
    return replace(motion, joints=held)


def _fit(motion: Motion) -> str:
    skeleton = get_skeleton(motion.skeleton)
    joints = np.asarray(motion.joints) * skeleton.meters
    error = np.linalg.norm(fit_rig(joints, rest_pose(skeleton), motion.fps).positions - joints, axis=-1)
    return (
        f": rotations reproduce the joints to {error.mean() * 1000:.1f} mm (mean), {error.max() * 1000:.0f} mm (most)"
    )

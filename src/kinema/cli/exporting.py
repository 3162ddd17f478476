"""Do what `kinema export` is asked: write a motion in another format, cleaned and changed for the tool it is for."""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
import torch

from kinema.cli.convention import told
from kinema.motion import export as write
from kinema.motion.captures.capture import Capture
from kinema.motion.feet import lock_feet
from kinema.motion.physics import foot_skating
from kinema.motion.recording import read_recording
from kinema.motion.rig.changes import Changes, Degrees, FrameRate
from kinema.motion.skeleton import Skeleton, get_skeleton
from kinema.options import check_value
from kinema.types import Motion


def export(options: argparse.Namespace) -> None:
    """Write a motion in the format that the file's suffix names, and say how near rotations come to it."""
    for option, value, kind in (("--rate", options.rate, FrameRate), ("--facing", options.facing, Degrees)):
        if value is not None:
            check_value(value, kind, option)
    recording = read_recording(options.motion, told(options))
    print(f"read {recording.path}: {recording.note}")
    skeleton = recording.skeleton
    motion = recording.motion(skeleton, skeleton.essential_width)
    if options.lock_feet:
        # A capture's floor is where its feet are; that of features is at 0.
        floor = float(motion.joints[..., 1].min()) if recording.features is None else 0.0
        motion = _standing(motion, skeleton, floor)
    changes = Changes(options.rate, options.in_place, options.facing, options.loop, options.z_up, options.unit)
    path = write.save(motion, options.out, changes)
    rigged = write.RIGGED.get(write.format_of(path))
    print(f"wrote {path}{'' if rigged is None else _fit(motion, rigged.fit(motion))}")


def _standing(motion: Motion, skeleton: Skeleton, floor: float) -> Motion:
    """Hold feet that stand on the floor, and say what that changed."""
    raised = np.array([0, floor, 0], dtype=np.float32)
    standing = motion.joints - raised
    held = lock_feet(standing, skeleton, motion.fps).astype(np.float32)
    before, after = (
        float(foot_skating(torch.as_tensor(joints)[None], torch.tensor([len(joints)]), skeleton))
        for joints in (standing, held)
    )
    farthest = np.linalg.norm(held - standing, axis=-1).max() * skeleton.meters * 100
    print(f"feet      {before:.1%} of low frames slid, now {after:.1%}; no joint moved by more than {farthest:.1f} cm")
    return replace(motion, joints=held + raised)


def _fit(motion: Motion, fitted: Capture) -> str:
    """Say how near rotations come to the joints."""
    joints = np.asarray(motion.joints) * get_skeleton(motion.skeleton).meters
    error = np.linalg.norm(fitted.positions - joints, axis=-1) * 1000
    return f": rotations reproduce the joints to {error.mean():.1f} mm on average, {error.max():.0f} mm at most"

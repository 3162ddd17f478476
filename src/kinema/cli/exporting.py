"""Do what `kinema export` is asked: write a motion in another format, cleaned and changed for the tool it is for."""

from __future__ import annotations

import argparse

import numpy as np

from kinema.cli.convention import told
from kinema.motion import export as write
from kinema.motion.captures.capture import Capture
from kinema.motion.cleaning import Held, described, floor_of
from kinema.motion.recording import Recording, read_recording
from kinema.motion.rig.changes import Changes, Degrees, FrameRate
from kinema.motion.skeleton import get_skeleton
from kinema.options import check_value
from kinema.pipeline.editing import TASKS, parse_ranges
from kinema.types import Motion


def export(options: argparse.Namespace) -> None:
    """Write a motion in the format that the file's suffix names, and say how near rotations come to it."""
    for option, value, kind in (("--rate", options.rate, FrameRate), ("--facing", options.facing, Degrees)):
        if value is not None:
            check_value(value, kind, option)
    recording = read_part(options)
    print(f"read {recording.path}: {recording.note}")
    skeleton = recording.skeleton
    changes = Changes(options.rate, options.in_place, options.facing, options.loop, options.z_up, options.unit)
    write.check(options.out, skeleton, changes)
    motion = recording.motion(skeleton, skeleton.essential_width)
    if options.lock_feet:
        # A capture's floor is where its feet are, that of features where its rows say.
        (motion,) = stand([motion], float(motion.joints[..., 1].min()) if recording.features is None else None)
    path = write.save(motion, options.out, changes)
    rigged = write.RIGGED.get(write.format_of(path))
    print(f"wrote {path}{'' if rigged is None else _fit(motion, rigged.fit(motion))}")


def read_part(options: argparse.Namespace) -> Recording:
    """Read the motion that is named, or the part of it that is asked for."""
    recording = read_recording(options.motion, told(options))
    if options.part is None:
        return recording
    size = len(recording.joints)
    ranges = parse_ranges(options.part, size, recording.skeleton.fps)
    if len(ranges) != 1 or options.part in TASKS:
        raise ValueError(f"--part {options.part} is no single START:END; give one, in frames of {size} or seconds")
    return recording.part(*ranges[0])


def stand(motions: list[Motion], floor: float | None = None) -> list[Motion]:
    """Hold feet that stand on the floor (None: that of the motions' rows), and say what that changed."""
    held = [Held.of(motion, floor_of(motion) if floor is None else floor) for motion in motions]
    print(f"feet      {described(held)}")
    return [one.motion for one in held]


def _fit(motion: Motion, fitted: Capture) -> str:
    """Say how near rotations come to the joints."""
    joints = np.asarray(motion.joints) * get_skeleton(motion.skeleton).meters
    error = np.linalg.norm(fitted.positions - joints, axis=-1) * 1000
    return f": rotations reproduce the joints to {error.mean():.1f} mm on average, {error.max():.0f} mm at most"

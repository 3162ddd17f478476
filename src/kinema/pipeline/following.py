"""Generate motion that goes along a way over the floor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kinema.motion.carrying import carry, course
from kinema.motion.skeleton import Skeleton
from kinema.motion.trajectory import Trajectory
from kinema.motion.waypoints import Waypoints
from kinema.pipeline.text_to_motion import TextToMotion
from kinema.types import Motion


@dataclass(frozen=True)
class Followed:
    """Hold motions along a way, how far their roots are from it (metres, mean over frames) and how it was done.

    `strides` says of each how much farther it steps than it was generated to; None: the network knew the way.
    """

    motions: list[Motion]
    away: float
    strides: list[float] | None


def follow(
    model: TextToMotion, texts: Sequence[str], way: Waypoints, count: int | None = None, **options: Any
) -> Followed:
    """Generate one motion per text that goes along a way, in `count` frames or (None) in the way's own time.

    A method that generates frames is given the root's columns, which it completes; of any other the generated motion
    is carried along (`motion.carrying`). `options` are those of `TextToMotion.generate`. Raises ValueError for a way
    longer than the model's longest motion, or one along which what is generated does not travel.
    """
    skeleton = model.skeleton
    size = way.frames(skeleton.fps) if count is None else count
    meters, headings = way.at(size)
    places = meters / skeleton.meters
    if model.tokenizer.space.kind == "frames":
        source, trajectory = _known(model, places, headings)
        made = model.edit([source] * len(texts), texts, parts="body", blend=0.0, **options)
        motions = [replace(one, joints=trajectory.joints(one.features, skeleton), kept=None) for one in made]
        return Followed(motions, _away(motions, meters, skeleton), None)
    return carried(model.generate(texts, size, **options), way, skeleton, size)


def carried(motions: Sequence[Motion], way: Waypoints, skeleton: Skeleton, count: int | None = None) -> Followed:
    """Take motions along a way as they are (`motion.carrying`), in `count` frames or (None) in the way's own time."""
    meters, headings = way.at(way.frames(skeleton.fps) if count is None else count)
    made, strides = [], []
    for one in motions:
        rows, trajectory, stride = carry(one.features, meters / skeleton.meters, headings, skeleton)
        made.append(replace(one, features=rows, joints=trajectory.joints(rows, skeleton), kept=None))
        strides.append(stride)
    return Followed(made, _away(made, meters, skeleton), strides)


def _known(model: TextToMotion, places: np.ndarray, headings: np.ndarray | None) -> tuple[Motion, Trajectory]:
    """Make rows that know the root's way alone; the body faces it unless headings say otherwise."""
    skeleton = model.skeleton
    faced = course(places, skeleton.meters * skeleton.fps) if headings is None else headings
    way = Trajectory(-faced, places)
    rows = way.steer(np.zeros((len(places), skeleton.essential_width), np.float32), skeleton)
    rows = np.pad(rows, [(0, 0), (0, model.tokenizer.representation.width - rows.shape[1])])
    joints = np.zeros((len(places), skeleton.num_joints, 3), np.float32)
    return Motion(joints, rows, "", skeleton.name, skeleton.fps), way


def _away(motions: list[Motion], meters: np.ndarray, skeleton: Skeleton) -> float:
    """Average how far roots are from their places, in metres."""
    found = [np.linalg.norm(m.joints[:, 0, [0, 2]] * skeleton.meters - meters, axis=-1).mean() for m in motions]
    return float(np.mean(found))

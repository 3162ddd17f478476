"""Regenerate a motion between frames that are held: their poses come back, and stand where they stood."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from kinema.motion.placement import Placement
from kinema.motion.recovery import recover_joints
from kinema.motion.skeleton import get_skeleton
from kinema.motion.trajectory import Trajectory, pinned
from kinema.pipeline.editing import complement
from kinema.pipeline.text_to_motion import TextToMotion
from kinema.types import Motion


@dataclass(frozen=True)
class HeldEdit:
    """Hold an edit, and how its root was led so that held frames stand in their places: metres and degrees at most.

    `away` is how far a joint of a held frame is from the source's, in metres, at most.
    """

    motion: Motion
    led: float
    turned: float
    away: float


def hold(model: TextToMotion, source: Motion, text: str, frames: Sequence[int], **options: Any) -> HeldEdit:
    """Regenerate everything but `frames` of a motion to a text; `options` are those of `TextToMotion.edit`.

    A latent of several frames is held whole: the generator knows it, and its rows come back bit by bit. An edit alone
    goes on from where new frames end; here the root is led, by parts over the new frames, to where the held ones were.
    Raises ValueError where latents have no place in time, or nothing is left to regenerate.
    """
    ranges = complement([(frame, frame + 1) for frame in sorted(set(frames))], len(source.features))
    if not ranges:
        raise ValueError("nothing to regenerate: every frame is held")
    (made,) = model.edit(source, text, [ranges], **options)
    skeleton, kept = get_skeleton(source.skeleton), made.kept
    assert kept is not None
    stood = recover_joints(torch.from_numpy(source.features), skeleton).numpy()
    placement = Placement.between(stood, source.joints, skeleton)
    # Rows of a file of joints were fitted to bones of other lengths: where the body stood, its joints say.
    places = placement.undo(source.joints)[:, 0, [0, 2]]
    way = pinned(made.features, replace(Trajectory.of(source.features), place=places), kept)
    rows = np.where(kept[:, None], made.features, way.steer(made.features, skeleton))
    before, after = Trajectory.of(made.features), Trajectory.of(rows)
    joints = placement.apply(way.joints(rows, skeleton))
    meters = skeleton.meters
    return HeldEdit(
        replace(made, features=rows, joints=joints),
        led=meters * float(np.linalg.norm(after.place - before.place, axis=-1).max()),
        turned=float(np.degrees(np.abs(after.yaw - before.yaw).max())),
        away=meters * float(np.linalg.norm(joints[kept] - source.joints[kept], axis=-1).max()),
    )

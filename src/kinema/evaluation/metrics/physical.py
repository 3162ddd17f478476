"""Measure what the evaluators hardly see: skating, jitter, floor, turns, speed (kinema.motion.physics)."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torchmetrics import Metric

from kinema.evaluation.metrics.finite import require_finite
from kinema.motion import physics
from kinema.motion.recovery import recover_joints
from kinema.motion.skeleton import Skeleton
from kinema.types import MotionBatch

TURNING = math.radians(30)
"""A real clip that turns by more counts for turn_ratio."""


MEASURES = {"skating": "foot_skating", "jitter": "jitter", "float": "float_mm", "penetration": "penetration_mm"}
"""States that are means over clips, and the keys of these means."""


class Physical(Metric):
    """Compare generated with real motion of the same captions.

    foot_skating, jitter, float_mm, penetration_mm: means over clips, real_* beside them. turn_ratio: generated |turn|
    over real |turn|, summed over the clips whose real turn exceeds 30 degrees; absent where none does.
    root_speed_ratio: deviation of the horizontal root velocity over all frames, generated over real. 1 is best for
    both ratios.
    """

    is_differentiable, full_state_update = False, False
    clips: Tensor
    generated_turn: Tensor
    generated_velocity: Tensor
    real_turn: Tensor
    real_velocity: Tensor

    def __init__(self, skeleton: Skeleton, **kwargs: object) -> None:
        super().__init__(**kwargs)
        self.skeleton = skeleton
        for side in ("generated", "real"):
            for name in (*MEASURES, "turn"):
                self.add_state(f"{side}_{name}", torch.zeros(()), dist_reduce_fx="sum")
            # Rows: frames, sum and sum of squares of the x and z velocity.
            self.add_state(f"{side}_velocity", torch.zeros(3, 2), dist_reduce_fx="sum")
        self.add_state("clips", torch.zeros((), dtype=torch.int64), dist_reduce_fx="sum")

    def update(self, generated: MotionBatch, real: MotionBatch) -> None:
        """Add motions; row i of both answers the same caption."""
        turns = {"generated": turn(generated), "real": turn(real)}
        turning = turns["real"].to(turns["generated"].device) > TURNING
        for side, batch in (("generated", generated), ("real", real)):
            require_finite(batch.features, f"{side} features", batch.clip_ids)
            joints = recover_joints(batch.features, self.skeleton)
            floating, penetration = physics.floor_distances(joints, batch.lengths, self.skeleton)
            self._add(f"{side}_skating", physics.foot_skating(joints, batch.lengths, self.skeleton).sum())
            jitter = physics.jitter(joints, batch.lengths, self.skeleton.fps, self.skeleton.unit)
            self._add(f"{side}_jitter", jitter.sum())
            self._add(f"{side}_float", floating.sum())
            self._add(f"{side}_penetration", penetration.sum())
            self._add(f"{side}_turn", turns[side][turning].sum())
            self._add(f"{side}_velocity", _velocity_moments(batch))
        self.clips += len(generated.lengths)

    def compute(self) -> dict[str, Tensor]:
        """Return the measures whose denominators are not zero."""
        out = {key: getattr(self, f"generated_{name}") / self.clips for name, key in MEASURES.items()}
        out |= {f"real_{key}": getattr(self, f"real_{name}") / self.clips for name, key in MEASURES.items()}
        if self.real_turn > 0:
            out["turn_ratio"] = self.generated_turn / self.real_turn
        speed = _deviation(self.real_velocity)
        if speed > 0:
            out["root_speed_ratio"] = _deviation(self.generated_velocity) / speed
        return out

    def _add(self, name: str, value: Tensor) -> None:
        setattr(self, name, getattr(self, name) + value.to(self.device))


def turn(batch: MotionBatch) -> Tensor:
    """Return the absolute total turn of each motion after its first row, radians.

    A clip's first row holds a jump of up to 90 degrees: extraction sets its first heading to 0 (HUMANML3D_DATA §3.6).
    """
    return physics.turn_angle(batch.features[:, 1:], batch.lengths - 1).abs()


def _velocity_moments(batch: MotionBatch) -> Tensor:
    velocity = batch.features[..., 1:3].masked_fill(~batch.mask[..., None], 0)
    frames = batch.lengths.sum().expand(2)
    return torch.stack([frames, velocity.sum((0, 1)), velocity.square().sum((0, 1))])


def _deviation(moments: Tensor) -> Tensor:
    frames, total, squares = moments
    return (squares / frames - (total / frames).square()).clamp(min=0).mean().sqrt()

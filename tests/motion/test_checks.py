from __future__ import annotations

import numpy as np
import pytest

from kinema.motion.checks import check_clip
from kinema.motion.skeleton import HUMANML3D, SKELETONS, Skeleton

BOTH = [pytest.param(s, id=s.name) for s in SKELETONS.values()]


@pytest.fixture
def body(wander):
    """Give a function that makes a clip; KIT's rest directions have left and right swapped (HUMANML3D_DATA §1)."""

    def make(skeleton: Skeleton, frames: int = 30) -> np.ndarray:
        return wander(skeleton, frames) * (1 if skeleton is HUMANML3D else -1, 1, 1)

    return make


@pytest.mark.parametrize("skeleton", BOTH)
def test_a_clean_clip_has_no_problems(skeleton, body):
    assert check_clip(body(skeleton), skeleton, skeleton.fps) == []


@pytest.mark.parametrize("skeleton", BOTH)
def test_each_problem_is_found_at_its_first_frame(skeleton, body):
    clean = body(skeleton)
    for kind, frame, damage in [
        ("nan", 7, lambda j: j[7:9, 3].fill(np.nan)),
        ("bone", 11, lambda j: np.copyto(j[11:, 2], j[11:, skeleton.parents[2]])),
        ("jump", 19, lambda j: np.add(j[20:], 3 / skeleton.meters, out=j[20:])),
    ]:
        joints = clean.copy()
        damage(joints)
        found = {p.kind: p for p in check_clip(joints, skeleton, skeleton.fps)}
        assert found[kind].frame == frame, kind
        assert str(frame) in found[kind].message


def test_a_wrong_shape_is_a_problem_not_a_crash():
    (problem,) = check_clip(np.zeros((10, 24, 3)), HUMANML3D, 20.0)
    assert problem.kind == "shape"
    assert "(10, 24, 3)" in problem.message

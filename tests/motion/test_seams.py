"""A seam's figures are those of the steps that touch it; the rest of the motion is measured apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kinema.motion.seams import seams
from kinema.motion.skeleton import HUMANML3D


def test_a_jump_at_a_seam_is_the_seams_alone():
    joints = np.zeros((40, 22, 3)) + np.array([0, 1.0, 0])
    joints[:, 10, 1] = 0.0  # the left toe is low
    joints[20:, :, 0] += 0.1  # all jump into frame 20
    joints[30:, 5, 2] += 0.05
    kept = np.ones(40, bool)
    kept[20:24] = False
    (seam,), rest = seams(joints, kept, HUMANML3D, 20.0)
    assert (seam.start, seam.end) == (20, 24)
    assert seam.step == pytest.approx(0.1)
    assert seam.jerk == pytest.approx(2 * 0.1 * 20**3)
    assert seam.skating == pytest.approx(1 / 5)
    assert rest.step == pytest.approx(0.05)
    assert rest.jerk == pytest.approx(2 * 0.05 / 22 * 20**3)
    assert rest.skating == 0


def test_a_motion_without_seams_has_none():
    found, rest = seams(np.zeros((3, 22, 3)), np.ones(3, bool), HUMANML3D, 20.0)
    assert found == []
    assert (rest.step, rest.jerk, rest.skating) == (0, 0, 0)


def test_seams_are_in_metres():
    joints = np.zeros((40, 22, 3)) + np.array([0, 1.0, 0])
    joints[20:, :, 0] += 0.1
    kept = np.ones(40, bool)
    kept[20:24] = False
    metres, mm = (
        seams(joints / unit, kept, replace(HUMANML3D, unit=name), 20.0)[0][0] for name, unit in (("m", 1), ("mm", 1e-3))
    )
    assert mm.step == pytest.approx(metres.step)

from __future__ import annotations

import numpy as np
import pytest

from kinema.motion.trajectory import Trajectory, pinned


def test_a_root_is_led_the_short_way_round():
    held = np.zeros(80, bool)
    held[[0, 79]] = True
    way = pinned(np.zeros((80, 67), np.float32), Trajectory(np.linspace(0, 3.5, 80), np.zeros((80, 2))), held)
    assert np.cos(way.yaw[79] - 3.5) == pytest.approx(1)
    assert np.ptp(way.yaw) < np.pi

"""Lifting gives back what extraction made of the same joints, and leaves the essential columns as they are."""

from __future__ import annotations

import numpy as np
import pytest

from kinema.motion.features import extract
from kinema.motion.lifting import lift
from kinema.motion.skeleton import HUMANML3D, KIT


@pytest.mark.parametrize("skeleton", [HUMANML3D, KIT], ids=lambda s: s.name)
@pytest.mark.parametrize("seed", [0, 1])
def test_redundant_columns_are_those_of_extraction(wander, skeleton, seed):
    rows = extract(wander(skeleton, 90, seed), skeleton)
    found = lift(rows[:, : skeleton.essential_width], skeleton)
    assert found.dtype == np.float32
    assert np.array_equal(found[:, : skeleton.essential_width], rows[:, : skeleton.essential_width])
    scale = 1 / skeleton.meters
    for name, tolerance in (("rotations", 2e-4), ("velocities", 2e-5 * scale)):
        columns = skeleton.groups[name]
        last = len(rows) if name == "rotations" else -1
        np.testing.assert_allclose(found[:last, columns], rows[:last, columns], atol=tolerance, rtol=0)
    columns = skeleton.groups["contacts"]
    assert (found[:-1, columns] == rows[:-1, columns]).mean() > 0.99  # a foot at the threshold


def test_the_last_row_repeats_the_step_before(wander):
    rows = extract(wander(HUMANML3D, 30), HUMANML3D)
    found = lift(rows, HUMANML3D)
    for name in ("velocities", "contacts"):
        columns = HUMANML3D.groups[name]
        assert np.array_equal(found[-1, columns], found[-2, columns])


def test_redundant_columns_that_are_given_are_not_read(wander):
    rows = extract(wander(HUMANML3D, 30), HUMANML3D)
    spoilt = rows.copy()
    spoilt[:, HUMANML3D.essential_width :] = np.nan
    assert np.array_equal(lift(spoilt, HUMANML3D), lift(rows, HUMANML3D))


def test_a_bone_without_length_gives_finite_rows():
    assert np.isfinite(lift(np.zeros((5, 67), dtype=np.float32), HUMANML3D)).all()


def test_one_frame_has_no_velocities():
    with pytest.raises(ValueError, match="1 frames has no velocities"):
        lift(np.zeros((1, 67), dtype=np.float32), HUMANML3D)

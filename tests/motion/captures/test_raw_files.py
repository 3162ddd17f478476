"""The public captures at hand become the corpus' joints, to a tenth of a millimetre (OPEN_MOCAP)."""

from __future__ import annotations

import numpy as np
import pytest
from tests.conftest import SHARED

from kinema.motion.captures.mapping import find_mapping
from kinema.motion.captures.reading import captured_joints, read_capture
from kinema.motion.resampling import resampled
from kinema.motion.skeleton import HUMANML3D

RAW = SHARED / "data" / "raw-mocap"
FILES = sorted(p for p in RAW.rglob("*") if p.suffix in (".bvh", ".amc"))
PREFIXES = ("", "bandai_", "cmu_")

pytestmark = pytest.mark.skipif(not FILES, reason=f"{RAW} is absent; set KINEMA_SHARED to run this test")


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_raw_capture_is_a_body_on_its_feet(path):
    joints, understood = captured_joints(read_capture(path), path)
    assert understood.up == "y"
    assert 1.4 < understood.height < 1.8
    assert joints[:, 15, 1].mean() - joints[:, [10, 11], 1].mean() > 1


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_raw_capture_gives_the_joints_of_the_corpus(path, open_mocap):
    known = [open_mocap / "joints" / f"{prefix}{path.stem}.npy" for prefix in PREFIXES]
    there = [file for file in known if file.exists()]
    if not there:
        pytest.skip(f"no clip of the corpus is {path.stem} whole")
    capture = read_capture(path)
    mapping = find_mapping(capture.names, path)
    positions = capture.part(mapping.skip_frames).positions
    mapped = np.einsum("js,tsc->tjc", mapping.weights(capture.names, HUMANML3D), positions) * mapping.scale
    expected = np.load(there[0])
    joints = resampled(mapped, capture.fps, 20)[: len(expected)]
    np.testing.assert_allclose(joints, expected, atol=1e-4)

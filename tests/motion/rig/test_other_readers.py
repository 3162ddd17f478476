"""Software that isn't ours reads the same motion, where it is installed."""

from __future__ import annotations

import numpy as np
import pytest

from kinema.data.synthetic import synthetic_catalog
from kinema.motion.captures.mapping import known_mappings
from kinema.motion.formats.bvh import bvh_text
from kinema.motion.rig.fit import fit_rig
from kinema.motion.rig.pose import HUMANML3D_REST
from kinema.motion.skeleton import HUMANML3D

MIXAMO = [next(iter(known_mappings()["mixamo"].joints[name])) for name in HUMANML3D.joint_names]


def test_bvhio_reads_a_bvh_to_the_tenth_of_a_millimetre(tmp_path):
    bvhio = pytest.importorskip("bvhio", reason="pip install bvhio")
    for clip in list(synthetic_catalog(size=12, seed=1))[:4]:
        fitted = fit_rig(clip.joints(), HUMANML3D_REST, 20)
        (tmp_path / "a.bvh").write_text(bvh_text(fitted))
        root = bvhio.readAsHierarchy(str(tmp_path / "a.bvh"))
        for frame in range(0, fitted.frames, 10):
            root.loadPose(frame)
            read = {joint.Name: np.array(joint.PositionWorld) for joint, _, _ in root.layout()}
            found = np.array([read[name] for name in MIXAMO]) / 100
            np.testing.assert_allclose(found, fitted.positions[frame], atol=1e-4)

from __future__ import annotations

import numpy as np
import pytest
import torch

from kinema.motion.features import canonicalise, extract
from kinema.motion.mirror import mirror_joints
from kinema.motion.recovery import recover_joints
from kinema.motion.skeleton import SKELETONS

BOTH = [pytest.param(s, id=s.name) for s in SKELETONS.values()]


@pytest.mark.parametrize("skeleton", BOTH)
def test_mirroring_twice_is_the_identity_and_leaves_the_input(skeleton, wander):
    joints = wander(skeleton, 10, seed=1)
    before = joints.copy()
    np.testing.assert_array_equal(mirror_joints(mirror_joints(joints, skeleton), skeleton), joints)
    np.testing.assert_array_equal(joints, before)


@pytest.mark.parametrize("skeleton", BOTH)
def test_mirroring_commutes_with_extraction(skeleton, wander):
    joints = canonicalise(wander(skeleton, 40, seed=2, turn=0.1), skeleton)
    features, mirrored = extract(joints, skeleton), extract(mirror_joints(joints, skeleton), skeleton)
    recovered = recover_joints(torch.from_numpy(mirrored), skeleton).numpy()
    expected = mirror_joints(recover_joints(torch.from_numpy(features), skeleton).numpy(), skeleton)
    np.testing.assert_allclose(recovered * skeleton.meters, expected * skeleton.meters, atol=1e-5)
    np.testing.assert_allclose(mirrored[:, 0], -features[:, 0], atol=1e-6)
    np.testing.assert_allclose(mirrored[:, 3], features[:, 3], rtol=1e-6)
    contacts = skeleton.groups["contacts"]
    np.testing.assert_array_equal(mirrored[:, contacts], features[:, contacts][:, [2, 3, 0, 1]])

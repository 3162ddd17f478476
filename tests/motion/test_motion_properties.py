"""Test round trips that must hold for any motion: rotations, mirror images, representations, extraction."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from kinema.motion.features import canonicalise, extract
from kinema.motion.kinematics import bone_lengths, bone_vectors, uniform_skeleton
from kinema.motion.mirror import mirror_joints
from kinema.motion.recovery import recover_joints
from kinema.motion.representation import VARIANTS, Representation
from kinema.motion.rotation import matrix_from_sixd, rotate_yaw, shortest_arc, sixd_from_matrix, unit
from kinema.motion.skeleton import DIMS, SKELETONS
from kinema.motion.statistics import Statistics

BOTH = st.sampled_from(sorted(SKELETONS.values(), key=lambda s: s.name))
COORDINATES = st.floats(-8, 8, width=32).map(lambda x: 0.0 if abs(x) < 1e-3 else x)
DIRECTIONS = hnp.arrays(np.float64, (5, 3), elements=COORDINATES).filter(lambda v: v.any(1).all()).map(unit)
ANGLES = st.floats(-20, 20)


def clips(skeleton) -> st.SearchStrategy[np.ndarray]:
    """Draw joints of three frames."""
    return hnp.arrays(np.float64, (3, skeleton.num_joints, 3), elements=COORDINATES)


@given(hnp.arrays(np.float64, (4, 2, 3), elements=COORDINATES), ANGLES)
def test_turning_back_is_the_identity(points, yaw):
    turned = rotate_yaw(points, yaw)
    np.testing.assert_allclose(np.linalg.norm(turned, axis=-1), np.linalg.norm(points, axis=-1), atol=1e-12)
    np.testing.assert_allclose(rotate_yaw(turned, -yaw), points, atol=1e-12)


@given(DIRECTIONS.flatmap(lambda s: st.tuples(st.just(s), DIRECTIONS | st.just(s) | st.just(-s))))
def test_a_shortest_arc_is_a_rotation_to_its_target_and_survives_six_numbers(case):
    source, target = case
    matrices = shortest_arc(source, target)
    np.testing.assert_allclose((matrices @ source[..., None])[..., 0], target, atol=1e-4)
    np.testing.assert_allclose(matrices @ matrices.mT, np.broadcast_to(np.eye(3), (5, 3, 3)), atol=1e-4)
    np.testing.assert_allclose(np.linalg.det(matrices), 1, atol=1e-4)
    back = matrix_from_sixd(torch.from_numpy(sixd_from_matrix(matrices))).numpy()
    np.testing.assert_allclose(back, matrices, atol=1e-4)


@given(BOTH.flatmap(lambda s: st.tuples(st.just(s), clips(s))))
def test_mirroring_twice_is_the_identity_and_swaps_the_sides_of_bones(case):
    skeleton, joints = case
    mirrored = mirror_joints(joints, skeleton)
    np.testing.assert_array_equal(mirror_joints(mirrored, skeleton), joints)
    order = np.arange(skeleton.num_joints)
    for left, right in skeleton.mirror_pairs:
        order[[left, right]] = right, left
    np.testing.assert_allclose(bone_lengths(mirrored, skeleton)[:, order], bone_lengths(joints, skeleton))


@settings(max_examples=12)
@given(skeleton=BOTH, seed=st.integers(0, 2**32 - 1), turn=st.floats(-0.3, 0.3))
def test_rows_of_features_hold_the_clip(wander, skeleton, seed, turn):
    joints = canonicalise(wander(skeleton, 24, seed=seed, turn=turn), skeleton)
    recovered = recover_joints(torch.from_numpy(extract(joints, skeleton)), skeleton).numpy()
    np.testing.assert_allclose(recovered * skeleton.meters, joints[:-1] * skeleton.meters, atol=2e-5)


@settings(max_examples=12)
@given(skeleton=BOTH, seed=st.integers(0, 2**32 - 1), scale=st.floats(0.4, 2.5))
def test_bones_get_the_lengths_asked_for_and_keep_their_directions(wander, skeleton, seed, scale):
    joints = wander(skeleton, 6, seed=seed)
    target = bone_lengths(joints, skeleton)[0] * scale
    changed = uniform_skeleton(joints, skeleton, target)
    np.testing.assert_allclose(bone_lengths(changed, skeleton), np.broadcast_to(target, (6, len(target))), rtol=1e-9)
    np.testing.assert_allclose(unit(bone_vectors(changed, skeleton)), unit(bone_vectors(joints, skeleton)), atol=1e-9)


@pytest.mark.parametrize("kind", DIMS)
@given(
    skeleton=BOTH, variant=st.sampled_from(VARIANTS), lengths=st.tuples(st.integers(1, 5), st.just(5)), data=st.data()
)
def test_denormalising_undoes_normalising_and_essential_is_the_front_of_redundant(
    kind, skeleton, variant, lengths, data
):
    rows = hnp.arrays(np.float32, (2, 5, skeleton.feature_width), elements=st.floats(-9, 9, width=32))
    features, spread = torch.from_numpy(data.draw(rows)), np.linspace(0.1, 3, skeleton.feature_width)
    statistics = Statistics(spread[::-1].copy(), spread)
    narrow, wide = (Representation(k, skeleton.name, variant).fit(statistics) for k in (kind, "redundant"))
    counted = torch.tensor(lengths)
    normal = narrow.normalize(features, counted)
    assert torch.equal(normal, wide.normalize(features, counted)[..., : narrow.width])
    back, expected = narrow.denormalize(normal, counted), features[..., : narrow.width].clone()
    for row, length in zip(expected, lengths, strict=True):
        row[length:] = 0
    torch.testing.assert_close(back, expected, rtol=1e-5, atol=1e-4)

"""Metrics keep their promises: exact where they should be, blind to order, and clear about bad rows."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import torch

from kinema.evaluation.metrics import (
    ClipScore,
    Diversity,
    FrechetDistance,
    MultiModality,
    Physical,
    Reconstruction,
    Retrieval,
)
from kinema.evaluation.metrics.diversity import draw_pairs, mean_distance
from kinema.evaluation.metrics.finite import require_finite
from kinema.motion import physics
from kinema.motion.recovery import recover_joints
from kinema.motion.skeleton import HUMANML3D, KIT


def normal(*size, seed=0):
    return torch.from_numpy(np.random.default_rng(seed).normal(size=size).astype(np.float32))


def frechet(a, b):
    metric = FrechetDistance(a.shape[1])
    metric.update(a, b)
    return metric.compute().item()


def test_frechet_distance_is_the_matrix_root_formula_and_zero_for_equal_sets():
    a, b = normal(90, 12), 2 * normal(70, 12, seed=1) + 1
    x, y = a.numpy().astype(np.float64), b.numpy().astype(np.float64)
    cov_a, cov_b = np.cov(x, rowvar=False), np.cov(y, rowvar=False)
    root = scipy.linalg.sqrtm(cov_a @ cov_b).real
    expected = np.sum((x.mean(0) - y.mean(0)) ** 2) + np.trace(cov_a + cov_b - 2 * root)
    assert frechet(a, b) == pytest.approx(expected, rel=1e-9)
    assert frechet(b, a) == pytest.approx(expected, rel=1e-9)
    assert 0 <= frechet(a, a) < 1e-9
    # An offset that float32 sums would lose.
    assert frechet(a + 300, b + 300) == pytest.approx(expected, rel=1e-4)


def test_random_embeddings_score_chance():
    metric = Retrieval()
    for seed in range(40):
        metric.update(normal(32, 16, seed=seed), normal(32, 16, seed=1000 + seed))
    found = metric.compute()
    for k in (1, 2, 3):
        deviation = math.sqrt(k / 32 * (1 - k / 32) / (40 * 32))
        assert abs(found[f"r{k}"] - k / 32) < 3 * deviation


def test_pools_do_not_cross_updates_and_kept_rows_meet_their_whole_pool():
    text, motion = normal(64, 6), normal(64, 6, seed=1)
    whole, parts = Retrieval(), Retrieval()
    whole.update(text, motion)
    for rows in (slice(0, 32), slice(32, 64)):
        parts.update(text[rows], motion[rows])
    assert torch.equal(whole.hits, parts.hits)
    keep = torch.arange(64) % 3 == 0
    one, other = Retrieval(), Retrieval()
    one.update(text, motion, keep)
    other.update(text, motion, ~keep)
    assert torch.equal(one.hits + other.hits, whole.hits)
    assert one.count == keep.sum()


@pytest.mark.parametrize(("leftover", "count"), [("drop", 32), ("mld", 32), ("keep", 40)])
def test_leftover_rows(leftover, count):
    metric = Retrieval(leftover=leftover)
    metric.update(normal(40, 4), normal(40, 4))
    assert metric.count == count
    assert metric.compute()["r1"] == 1


def test_no_full_pool_gives_no_number():
    metric = Retrieval()
    metric.update(normal(8, 4), normal(8, 4))
    assert metric.compute() == {}


def test_diversity_does_not_depend_on_order_or_batches():
    rows, index = normal(400, 5), torch.arange(400)
    order = torch.from_numpy(np.random.default_rng(2).permutation(400))
    one, other = Diversity(), Diversity()
    one.update(rows, index)
    for part in order.split(33):
        other.update(rows[part], index[part])
    assert torch.equal(one.compute(), other.compute())


@pytest.mark.parametrize(("count", "pairs"), [(301, 300), (300, 100), (101, 100), (100, 99), (2, 1)])
def test_few_rows_give_fewer_pairs(count, pairs):
    first, second = draw_pairs(count, 300, seed=0)
    assert len(first) == len(second) == pairs
    assert len(set(first.tolist())) == pairs
    with pytest.raises(ValueError, match="at least 2 motions, got 1"):
        draw_pairs(1, 300, seed=0)


def test_multimodality_draws_the_same_pairs_for_every_caption():
    rows = normal(6, 30, 5)
    metric = MultiModality(seed=4)
    metric.update(rows[:2])
    metric.update(rows[2:])
    first, second = draw_pairs(30, 10, seed=4)
    expected = torch.stack([mean_distance(r, first, second) for r in rows]).mean()
    torch.testing.assert_close(metric.compute(), expected)
    few = MultiModality(seed=4)
    few.update(rows[:, :2])  # two answers leave one pair, of either order or of one answer with itself
    distances = (rows[:, 0] - rows[:, 1]).norm(dim=-1).mean()
    assert few.compute() == 0 or torch.isclose(few.compute(), distances)
    with pytest.raises(ValueError, match="at least 2 generations of a caption, got 1"):
        metric.update(rows[:, :1])


def test_clip_score_is_the_mean_cosine():
    metric = ClipScore()
    metric.update(torch.tensor([[2.0, 0.0], [0.0, 3.0]]), torch.tensor([[1.0, 0.0], [1.0, 0.0]]))
    assert metric.compute() == 0.5


@pytest.mark.parametrize("skeleton", [HUMANML3D, KIT], ids=lambda s: s.name)
def test_reconstruction_errors_are_millimetres_and_degrees(make, skeleton):
    unit = 1 / skeleton.meters  # one metre in the skeleton's unit
    real = make.batch(size=3, width=skeleton.essential_width, lengths=[40, 24, 12])
    moved = real.features.clone()
    joints = moved[..., skeleton.groups["joints"]]
    joints[..., 3] += 0.1 * unit  # one joint of J is off by 10 cm
    metric = Reconstruction(skeleton)
    metric.update(moved, real.features, real.lengths)
    found = metric.compute()
    expected = 100 / skeleton.num_joints
    assert found["mpjpe_mm"].item() == pytest.approx(expected, rel=1e-3)
    assert found["mpjpe_heading_mm"].item() == pytest.approx(expected, rel=1e-3)
    assert found["heading_error_deg"] == 0


def test_a_wrong_heading_is_no_error_in_the_heading_frame(make):
    real = make.batch(size=2, width=67, lengths=[40, 40])
    turned = real.features.clone()
    turned[:, 0, 0] += math.radians(15)  # a half angle: 30 degrees from the second frame on
    metric = Reconstruction(HUMANML3D)
    metric.update(turned, real.features, real.lengths)
    found = metric.compute()
    assert found["heading_error_deg"].item() == pytest.approx(30 * 39 / 40, rel=1e-4)
    assert found["mpjpe_heading_mm"] == 0
    joints = [recover_joints(f, HUMANML3D) for f in (turned, real.features)]
    aligned = [j - j[..., :1, :] for j in joints]
    assert found["mpjpe_mm"].item() == pytest.approx(
        1000 * (aligned[0] - aligned[1]).norm(dim=-1).mean().item(), rel=1e-4
    )


def test_turns_and_speeds_are_compared_with_the_real_ones(make):
    real = make.batch(size=4, width=67, lengths=[40, 40, 20, 20])
    real.features[..., 0] = 0
    real.features[0, :10, 0] = math.radians(90) / 2 / 10
    real.features[1, :10, 0] = -math.radians(60) / 2 / 10
    real.features[2, :10, 0] = math.radians(20) / 2 / 10  # below 30 degrees: not counted
    half = replace(real, features=real.features.clone())
    half.features[..., :3] *= 0.5
    metric = Physical(HUMANML3D)
    metric.update(half, real)
    found = metric.compute()
    assert found["turn_ratio"].item() == pytest.approx(0.5, rel=1e-5)
    assert found["root_speed_ratio"].item() == pytest.approx(0.5, rel=1e-5)
    velocity = real.features[..., 1:3][real.mask]
    assert metric.real_velocity[0, 0] == len(velocity)
    still = replace(real, features=torch.zeros_like(real.features))
    metric = Physical(HUMANML3D)
    metric.update(half, still)
    assert not {"turn_ratio", "root_speed_ratio"} & set(metric.compute())


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_rows_that_are_not_finite_are_named(bad):
    values = normal(4, 3)
    values[2, 1] = bad
    with pytest.raises(ValueError, match="embeddings of third hold NaN or infinity"):
        require_finite(values, "embeddings", ["first", "second", "third", "fourth"])
    with pytest.raises(ValueError, match="generated motion embeddings of row 2"):
        FrechetDistance(3).update(normal(4, 3), values)
    for metric in (Retrieval(pool=4), ClipScore()):
        with pytest.raises(ValueError, match="row 2"):
            metric.update(normal(4, 3), values)


def test_too_few_motions_for_fid():
    metric = FrechetDistance(3)
    metric.update(normal(5, 3), normal(1, 3))
    with pytest.raises(ValueError, match="at least 2 generated motions, got 1"):
        metric.compute()


def turning(make, *degrees):
    real = make.batch(size=len(degrees), width=67, lengths=[40] * len(degrees))
    real.features[..., 0] = 0
    for row, d in zip(real.features, degrees, strict=True):
        row[1:10, 0] = math.radians(d) / 2 / 9
    return real


def test_the_first_rows_jump_and_the_side_of_a_turn_do_not_count(make):
    real = turning(make, 90, -60)
    half = replace(real, features=real.features.clone())
    half.features[0, :, 0] *= 0.5  # 45 of 90 and 60 of 60 degrees
    half.features[:, 0, 0] = math.pi / 4  # extraction's jump
    metric = Physical(HUMANML3D)
    metric.update(half, real)
    assert metric.compute()["turn_ratio"].item() == pytest.approx((45 + 60) / 150, rel=1e-4)


def test_jitter_of_kit_is_in_metres(make):
    real = make.batch(size=2, width=64, lengths=[40, 40])
    metric = Physical(KIT)
    metric.update(real, real)
    expected = physics.jitter(recover_joints(real.features, KIT) / 1000, real.lengths, KIT.fps).mean()
    assert metric.compute()["jitter"].item() == pytest.approx(expected.item(), rel=1e-4)


def test_kept_rows_are_those_of_the_pools(make):
    rows = torch.arange(6.0)[:, None].expand(6, 3)
    metric = Retrieval(pool=4)
    metric.update(rows, rows, torch.tensor([True, False, False, False, True, True]))
    assert metric.count == 1

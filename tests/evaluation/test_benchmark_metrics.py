"""The benchmark's metrics agree with other ways to compute them, and know nothing of order and batches."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
import torch
from scipy.spatial.distance import cdist
from sklearn.neighbors import NearestNeighbors

from kinema.evaluation.metrics import (
    PRDC,
    FrechetDistance,
    HalvesDistance,
    NearestTraining,
    RetrievalShare,
    UnitFrechetDistance,
    neighbours,
)
from kinema.evaluation.metrics.halves import halves_distance
from kinema.evaluation.metrics.neighbours import isolation


def normal(*size, seed=0):
    return torch.from_numpy(np.random.default_rng(seed).normal(size=size).astype(np.float32))


def takes(*numbers):
    """Make origins of whole takes by number."""
    return torch.tensor([[number, 0, 9] for number in numbers])


def whole(metric, *rows):
    metric.update(*rows)
    return {name: float(value) for name, value in metric.compute().items()}


def in_batches(metric, *rows, size=7):
    for part in zip(*(r.split(size) for r in rows), strict=True):
        metric.update(*part)
    return {name: float(value) for name, value in metric.compute().items()}


def frechet(a, b):
    x, y = (np.asarray(rows, dtype=np.float64) for rows in (a, b))
    covs = [np.cov(rows, rowvar=False) for rows in (x, y)]
    root = scipy.linalg.sqrtm(covs[0] @ covs[1]).real
    return np.sum((x.mean(0) - y.mean(0)) ** 2) + np.trace(covs[0] + covs[1] - 2 * root)


@pytest.mark.parametrize(("leftover", "rows"), [("drop", 64), ("keep", 72), ("mld", 64)])
def test_share_of_real_is_that_of_sorted_distances(leftover, rows):
    text, real = normal(72, 6), normal(72, 6) + 0.4 * normal(72, 6, seed=1)
    made = text + 0.8 * normal(72, 6, seed=2)

    def hits(motion, k):
        found = 0
        for first in range(0, rows, 32):
            pool = slice(first, min(first + 32, rows))
            order = np.argsort(cdist(text[pool], motion[pool]), axis=1, kind="stable")
            found += sum(i in order[i, :k] for i in range(len(order)))
        return found

    found = whole(RetrievalShare(leftover=leftover), text, made, real)
    assert found == pytest.approx({f"r{k}_of_real": hits(made, k) / hits(real, k) for k in (1, 2, 3)})
    assert in_batches(RetrievalShare(leftover=leftover), text, made, real, size=32) == found


def test_share_of_real_is_one_for_real_motion_above_one_for_literal_answers_and_absent_without_a_hit():
    text, real = normal(64, 6), normal(64, 6) + normal(64, 6, seed=1)
    assert set(whole(RetrievalShare(), text, real, real).values()) == {1.0}
    assert whole(RetrievalShare(), text, text, real)["r1_of_real"] > 1
    assert whole(RetrievalShare(pool=2), text[:2], text[:2], text[:2].flip(0)) == {"r2_of_real": 1, "r3_of_real": 1}
    assert whole(RetrievalShare(), text[:8], text[:8], real[:8]) == {}  # no whole pool


def test_halves_are_compared_by_the_matrix_root_formula():
    real, made, index = normal(61, 5), 1.5 * normal(61, 5, seed=1) + 0.3, torch.arange(61)
    order = np.random.default_rng(9).permutation(61)
    first, second = order[:30], order[30:60]
    found = whole(HalvesDistance(seed=9), real, made, index)
    assert found["fid_halves"] == pytest.approx(frechet(made[first], real[second]), rel=1e-9)
    assert found["real_fid_halves"] == pytest.approx(frechet(real[first], real[second]), rel=1e-9)
    shuffled = torch.from_numpy(np.random.default_rng(1).permutation(61))
    assert in_batches(HalvesDistance(seed=9), real[shuffled], made[shuffled], index[shuffled]) == found
    same = whole(HalvesDistance(seed=9), real, real, index)
    assert same["fid_halves"] == same["real_fid_halves"] == found["real_fid_halves"]
    assert whole(HalvesDistance(), real[:3], real[:3], index[:3]) == {}


def test_half_against_half_is_small_for_one_population_and_falls_with_n():
    few, many = (halves_distance(rows, rows, seed=3) for rows in (normal(80, 8), normal(2000, 8)))
    assert 0 < many < few / 5
    assert halves_distance(normal(80, 8), normal(80, 8), seed=4) != few


def test_fid_on_the_sphere_is_that_of_unit_rows_and_blind_to_length():
    real, made = normal(90, 6), normal(70, 6, seed=1) + 0.5
    metric, scaled = UnitFrechetDistance(6), UnitFrechetDistance(6)
    metric.update(real, made)
    x, y = (rows.numpy() / np.linalg.norm(rows, axis=1, keepdims=True) for rows in (real, made))
    assert metric.compute().item() == pytest.approx(frechet(x, y), rel=1e-4)
    lengths = torch.rand(90, 1, generator=torch.Generator().manual_seed(0)) + 0.1
    for part in (slice(0, 40), slice(40, 90)):
        scaled.update((real * lengths)[part], 7 * made[part])
    assert scaled.compute().item() == pytest.approx(metric.compute().item(), rel=1e-4)
    opposite = UnitFrechetDistance(6)
    opposite.update(torch.eye(6)[:1].expand(8, 6), -torch.eye(6)[:1].expand(8, 6))
    assert opposite.compute().item() == pytest.approx(4)  # the greatest value
    plain = FrechetDistance(6)
    plain.update(real, made)
    assert plain.compute() != metric.compute()


def prdc_by_search(real, made, k):
    """Count by scikit-learn's search in trees, a ball at a time."""

    def balls(centres, others):
        radii = NearestNeighbors(n_neighbors=k + 1).fit(centres).kneighbors(centres)[0][:, k]
        tree = NearestNeighbors().fit(others)
        return [tree.radius_neighbors([c], radius=r)[1][0] for c, r in zip(centres, radii, strict=True)]

    around_real, around_made = balls(real, made), balls(made, real)
    return {
        "precision": len(set(np.concatenate(around_real))) / len(made),
        "recall": len(set(np.concatenate(around_made))) / len(real),
        "density": sum(map(len, around_real)) / k / len(made),
        "coverage": sum(len(ball) > 0 for ball in around_real) / len(real),
    }


@pytest.mark.parametrize("k", [1, 5])
@pytest.mark.parametrize(("shift", "scale"), [(0.0, 1.0), (0.8, 0.6), (0.0, 1.8)])
def test_prdc_is_what_a_search_in_trees_counts(k, shift, scale, monkeypatch):
    real, made = normal(120, 4), scale * normal(90, 4, seed=1) + shift
    found = whole(PRDC(k), real, made)
    assert found == pytest.approx(prdc_by_search(real.double().numpy(), made.double().numpy(), k), abs=1e-12)
    assert all(0 < found[name] <= 1 for name in ("precision", "recall", "coverage"))
    order = torch.from_numpy(np.random.default_rng(2).permutation(90))
    assert in_batches(PRDC(k), real[:90], made[order]) == pytest.approx(whole(PRDC(k), real[:90], made), abs=1e-12)
    monkeypatch.setattr(neighbours, "ROWS", 16)
    assert whole(PRDC(k), real, made) == pytest.approx(found, abs=1e-12)


def test_prdc_of_a_set_with_itself_and_of_one_far_away():
    rows = normal(100, 6)
    assert whole(PRDC(), rows, rows) == {"precision": 1, "recall": 1, "density": 1, "coverage": 1}
    assert set(whole(PRDC(), rows, rows + 100).values()) == {0.0}
    assert whole(PRDC(), rows[:5], rows) == {}
    few = whole(PRDC(), rows, rows[:1].expand(100, 6))  # a collapsed generator is precise, and covers nothing
    assert few["precision"] == 1
    assert few["coverage"] < 0.2
    with pytest.raises(ValueError, match="k=0; it must be at least 1"):
        PRDC(0)


def test_prdc_of_one_population_is_as_expected():
    """Density 1; coverage 1 - (n-1)...(n-k) / ((2n-1)...(2n-k)) for n of each (Naeem et al. 2020)."""
    n, k = 200, 5
    found = [whole(PRDC(k), normal(n, 8, seed=2 * s), normal(n, 8, seed=2 * s + 1)) for s in range(30)]
    expected = 1 - np.prod([(n - i) / (2 * n - i) for i in range(1, k + 1)])
    assert np.mean([f["coverage"] for f in found]) == pytest.approx(expected, abs=0.005)
    assert np.mean([f["density"] for f in found]) == pytest.approx(1, abs=0.03)


def test_nearest_training_motion_and_the_memorised_share():
    training, made = normal(60, 5), normal(40, 5, seed=1)
    made[:10] = training[5:15] + 1e-3  # copies
    training[1::2] = training[::2] + 1e-4  # twins, which must not hide them
    own = isolation(training, takes(*(i // 2 for i in range(60))))
    between = cdist(training.double(), training.double())
    for i in range(60):
        assert own[i].item() == pytest.approx(min(between[i, j] for j in range(60) if j // 2 != i // 2), rel=1e-6)
    nearest, index = (a[:, 0] for a in NearestNeighbors(n_neighbors=1).fit(training.numpy()).kneighbors(made.numpy()))
    found = whole(NearestTraining(training, own), made)
    assert found["nearest_train"] == pytest.approx(nearest.mean(), rel=1e-5)
    assert found["memorised"] == pytest.approx(np.mean(nearest <= own.numpy()[index]))
    assert found["memorised"] >= 10 / 40
    order = torch.from_numpy(np.random.default_rng(2).permutation(40))
    assert in_batches(NearestTraining(training, own), made[order]) == pytest.approx(found, rel=1e-12)
    alone = isolation(training, takes(*range(60)))
    assert whole(NearestTraining(training, alone), made)["memorised"] < found["memorised"]


def test_training_motion_itself_is_memorised_and_distant_motion_is_not():
    training = 300 + normal(50, 5)  # an offset that float32 products would lose
    metric = NearestTraining(training, isolation(training, takes(*range(50))))
    assert whole(metric, training[:20]) == {"nearest_train": 0, "memorised": 1}
    metric.reset()
    far = whole(metric, training[:20] + 50)
    assert far["memorised"] == 0
    assert far["nearest_train"] > 80


def test_isolation_does_not_depend_on_parts(monkeypatch):
    rows, origins = normal(70, 5), takes(*(i % 30 for i in range(70)))
    expected = isolation(rows, origins)
    monkeypatch.setattr(neighbours, "ROWS", 16)
    torch.testing.assert_close(isolation(rows, origins), expected)
    assert isolation(rows, takes(*[0] * 70)).isinf().all()


def test_clips_that_share_frames_of_a_take_are_not_others():
    rows = torch.tensor([[0.0], [1.0], [2.0], [5.0], [9.0]])
    origins = torch.tensor([[0, 0, 40], [0, 39, 80], [0, 80, 120], [0, 20, 60], [1, 0, 40]])
    # The first overlaps the second and the fourth; the third begins where the second ends.
    assert isolation(rows, origins).tolist() == [2, 1, 1, 3, 4]


@pytest.mark.parametrize(
    ("metric", "rows"),
    [
        (RetrievalShare(4), 3),
        (HalvesDistance(), 2),
        (UnitFrechetDistance(3), 2),
        (PRDC(), 2),
        (NearestTraining(normal(8, 3), normal(8).abs()), 1),
    ],
    ids=lambda value: type(value).__name__,
)
def test_rows_that_are_not_finite_are_named(metric, rows):
    values = [normal(4, 3, seed=i) for i in range(rows)]
    values[min(1, rows - 1)][2, 1] = torch.nan
    places = [torch.arange(4)] if isinstance(metric, HalvesDistance) else []
    with pytest.raises(ValueError, match="row 2"):
        metric.update(*values, *places)

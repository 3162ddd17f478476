"""Metrics reproduce the published functions on recorded embeddings and draws."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
import torch
from safetensors.torch import load_file

from kinema.evaluation.metrics import ClipScore, FrechetDistance, Retrieval
from kinema.evaluation.metrics.diversity import mean_distance
from kinema.evaluation.metrics.reconstruction import mpjpe
from kinema.evaluation.metrics.retrieval import pool_ranks


@pytest.fixture
def golden(golden_file):
    return load_file(golden_file("mardm/mardm_metrics.safetensors"))


def fid(a, b):
    metric = FrechetDistance(a.shape[1])
    # In two updates of different size: sums must not depend on the batches.
    for part in (slice(0, 7), slice(7, None)):
        metric.update(a[part], b[part])
    return metric.compute()


def scores(text, motion, **options):
    metric = Retrieval(**options)
    metric.update(text, motion)
    return metric, metric.compute()


def test_retrieval(golden):
    _, found = scores(golden["in.text"], golden["in.pred"])
    np.testing.assert_allclose([found[k].item() for k in ("r1", "r2", "r3")], golden["out.r_precision"], rtol=1e-6)
    np.testing.assert_allclose(found["matching"], golden["out.matching"], rtol=1e-5)
    ranks = pool_ranks(golden["in.text"], golden["in.pred"], 32)[0].view(10, 32)
    hits = torch.stack([(ranks <= k).sum(1) for k in range(3)], dim=1)
    assert torch.equal(hits, golden["out.r_precision_hits_per_batch"])
    tied, _ = scores(golden["in.tie_text"], golden["in.tie_motion"])
    assert torch.equal(tied.hits, golden["out.tie_hits"])


def test_distances_within_a_pool(golden):
    text, motion = golden["in.text"][:32], golden["in.pred"][:32]
    own = pool_ranks(text, motion, 32)[1]
    np.testing.assert_allclose(own, golden["out.dist_batch0"].diagonal(), rtol=1e-4)


def test_frechet_distance(golden):
    np.testing.assert_allclose(fid(golden["in.gt"], golden["in.pred"]), golden["out.fid"], rtol=1e-4)
    product = golden["out.cov_gt"].numpy() @ golden["out.cov_pred"].numpy()
    trace = np.trace(scipy.linalg.sqrtm(product)).real
    means = (golden["in.gt"].double().mean(0) - golden["in.pred"].double().mean(0)).square().sum()
    expected = means + golden["out.cov_gt"].trace() + golden["out.cov_pred"].trace() - 2 * trace
    np.testing.assert_allclose(fid(golden["in.gt"], golden["in.pred"]), expected, rtol=1e-9)


def test_diversity_multimodality_clip_score_and_mpjpe(golden):
    found = mean_distance(golden["in.pred"], golden["in.div_first"], golden["in.div_second"])
    np.testing.assert_allclose(found, golden["out.diversity_300"], rtol=1e-5)
    repeats = golden["in.mm"].transpose(0, 1)
    found = mean_distance(repeats, golden["in.mm_first"], golden["in.mm_second"])
    np.testing.assert_allclose(found, golden["out.multimodality_10"], rtol=1e-5)
    np.testing.assert_allclose(
        mpjpe(golden["in.joints_pred"], golden["in.joints_gt"]), golden["out.mpjpe_per_frame"], rtol=1e-5
    )
    metric = ClipScore()
    metric.update(golden["in.pred"], golden["in.text"])
    np.testing.assert_allclose(metric.compute(), golden["out.clip_score"], rtol=1e-5)


CASES = [
    *("mean_shift_only", "rank_deficient", "rank_deficient_vs_full", "constant_generated", "large_scale"),
    *("large_offset", "unequal_n", "two_samples", "normal", "swapped", "same"),
]


@pytest.mark.parametrize("case", CASES)
def test_frechet_distance_edge_cases(golden_file, case):
    golden = load_file(golden_file("diffusion/metrics_fid.safetensors"))
    pair = {"normal": ("gt", "pred"), "swapped": ("pred", "gt"), "same": ("gt", "gt")}
    names = pair.get(case, (f"{case}.a", f"{case}.b"))
    a, b = (golden[f"in.{name}"] for name in names)
    metric = FrechetDistance(a.shape[1])
    metric.update(a, b)
    expected = golden[f"out.fid_stable.{case}"]
    np.testing.assert_allclose(metric.compute(), expected, rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("leftover", ["drop", "keep"])
def test_retrieval_leftover(golden_file, leftover):
    golden = load_file(golden_file("diffusion/metrics_rprecision.safetensors"))
    metric, found = scores(golden["in.text_remainder"], golden["in.motion_remainder"], leftover=leftover)
    expected = golden[f"out.remainder_{leftover}.r_precision"]
    np.testing.assert_allclose([found[k].item() for k in ("r1", "r2", "r3")], expected, rtol=1e-6)
    np.testing.assert_allclose(found["matching"], golden[f"out.remainder_{leftover}.matching"], rtol=1e-5)
    assert metric.count == golden[f"out.remainder_{leftover}.n"]


def test_retrieval_ties_and_identical_rows(golden_file):
    golden = load_file(golden_file("diffusion/metrics_rprecision.safetensors"))
    tied, _ = scores(golden["in.tie_text"], golden["in.tie_motion"])
    assert torch.equal(tied.hits, golden["out.tie_hits_stable"])
    same, found = scores(golden["in.identical"], golden["in.identical"])
    assert torch.equal(same.hits, golden["out.identical_hits_expected"])
    assert found["matching"] == golden["out.identical_matching_expected"]

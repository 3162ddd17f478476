"""The diagnosis' formulas on data whose answer is known: Gaussians, scaled columns, predictors that are given."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from kinema.diffusion.ddpm import DDPM
from kinema.diffusion.flow import Flow
from kinema.evaluation.diagnosis import amplification
from kinema.evaluation.diagnosis.deviations import own_deviations, phi
from kinema.evaluation.diagnosis.directions import bands, noise_found, principal
from kinema.evaluation.diagnosis.groups import by_group, shares
from kinema.evaluation.diagnosis.marginals import marginals, wasserstein
from kinema.evaluation.diagnosis.probes import probe
from kinema.generators.mar import MARDM
from kinema.generators.mdm import MDM
from kinema.motion.skeleton import get_skeleton
from kinema.motion.statistics import Statistics
from kinema.types import Latents, TextFeatures

SPREAD = 0.6
PREDICTIONS = ("epsilon", "x0", "velocity")


def noises(shape, seed=0):
    draw = torch.Generator().manual_seed(seed)
    while True:
        yield torch.randn(shape, generator=draw, dtype=torch.float64)


def best(process: DDPM):
    """Give the best model of N(0, SPREAD^2) data, as the process predicts."""

    def predict(x: Tensor, time: Tensor) -> Tensor:
        abar = process.schedule.alphas_cumprod[time.long()]
        clean = abar.sqrt() * SPREAD**2 / (abar * SPREAD**2 + 1 - abar) * x
        epsilon = (x - abar.sqrt() * clean) / (1 - abar).sqrt()
        outputs = {"x0": clean, "epsilon": epsilon, "velocity": abar.sqrt() * epsilon - (1 - abar).sqrt() * clean}
        return outputs[process.prediction]

    return predict


def stubborn(process: DDPM):
    """Give a model that says the same whatever it sees."""
    return lambda x, time: torch.full_like(x, 0.1) * time


@pytest.mark.parametrize("prediction", PREDICTIONS)
@pytest.mark.parametrize(("model", "spread"), [(best, SPREAD), (stubborn, None)])
def test_an_error_moves_samples_as_far_as_the_formula_says(prediction, model, spread):
    process = DDPM(20, prediction=prediction)
    predict, expected = model(process), amplification.in_sample(process, spread)
    base = process.sample(predict, noises((4, 3)))
    for at in (0, 1, 7, 18, 19):
        error = 0.01 * torch.ones(4, 3, dtype=torch.float64)
        off = amplification.moved(process, predict, noises((4, 3)), at, error) - base
        assert off.abs().mean().item() / 0.01 == pytest.approx(expected[at].item(), rel=1e-5, abs=1e-9)


def test_epsilon_carries_its_error_and_x0_forgets_it():
    epsilon, x0 = DDPM(50), DDPM(50, prediction="x0")
    schedule = epsilon.schedule
    alphas, abar = 1 - schedule.betas, schedule.alphas_cumprod
    sigma = (1 - abar).sqrt()
    torch.testing.assert_close(amplification.in_clean(epsilon), sigma / abar.sqrt())
    torch.testing.assert_close(amplification.in_step(epsilon), schedule.betas / (alphas.sqrt() * sigma))
    torch.testing.assert_close(amplification.in_sample(epsilon), schedule.betas / (abar.sqrt() * sigma))
    assert amplification.in_clean(x0).tolist() == [1] * 50
    assert amplification.in_sample(x0).tolist() == pytest.approx([1] + [0] * 49)
    assert amplification.in_clean(epsilon)[-1] > 1000


@pytest.mark.parametrize("prediction", PREDICTIONS)
def test_measured_errors_of_the_clean_estimate_are_those_of_the_output_amplified(prediction):
    process = DDPM(20, prediction=prediction)
    x1, noise = (SPREAD * next(noises((50, 3), seed)) for seed in (1, 2))
    for at in (0, 10, 19):
        output, clean = amplification.step_errors(process, best(process), x1, at, noise)
        expected = amplification.in_clean(process)[at].item()
        assert (clean.norm() / output.norm()).item() == pytest.approx(expected, rel=1e-4)


def test_phi_is_the_averaged_over_the_own_deviation():
    skeleton = get_skeleton("humanml3d")
    rng = np.random.default_rng(0)
    scales = rng.uniform(0.5, 2, skeleton.feature_width)
    features = rng.normal(size=(4000, skeleton.feature_width)) * scales
    features[:, 70] = 3.0
    own, statistics = own_deviations(features, rows=1500), Statistics.compute([features], skeleton)
    np.testing.assert_allclose(own, features.std(0), atol=1e-12)
    ratio, biased = phi(own, statistics), phi(own, statistics.published(skeleton))
    assert math.isnan(ratio[70])
    assert ratio[3] == pytest.approx(1)  # alone in its group
    joints = skeleton.groups["joints"]
    np.testing.assert_allclose(ratio[joints], own[joints].mean() / own[joints])
    np.testing.assert_allclose(biased[joints], ratio[joints])
    for group in ("root_yaw", "contacts"):
        np.testing.assert_allclose(25 * biased[skeleton.groups[group]], ratio[skeleton.groups[group]])
    summary = by_group(skeleton.groups, ratio, "phi")
    assert summary["rotations"]["phi_most"] == pytest.approx(np.nanmax(ratio[skeleton.groups["rotations"]]))


def test_distances_from_a_normal_are_the_analytic_ones():
    """W1 of N(m, 1) is |m|, of N(0, s^2) it is |s - 1| sqrt(2 / pi); KS of N(m, 1) is 2 Phi(|m| / 2) - 1."""
    normal = torch.randn(20000, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    normal = (normal - normal.mean()) / normal.std()
    found = marginals(torch.stack([normal, normal + 0.5, 3 * normal], dim=1))
    assert found.wasserstein.tolist() == pytest.approx([0, 0.5, 2 * math.sqrt(2 / math.pi)], abs=0.03)
    assert found.kolmogorov[:2].tolist() == pytest.approx([0, math.erf(0.25 / math.sqrt(2))], abs=0.01)
    assert found.std.tolist() == pytest.approx([1, 1, 3], abs=1e-3)
    ours, theirs = normal[:9000, None].numpy(), normal[9000:, None].numpy()
    assert wasserstein(ours + 2, theirs) == pytest.approx(2, abs=0.03)


def test_shares_of_a_loss_add_up():
    groups = {"a": slice(0, 1), "b": slice(1, 4)}
    found = shares(groups, np.array([3.0, 1.0, 1.0, 1.0]))
    assert found["a"] == {"columns": 0.25, "loss": 3.0, "share": 0.5}
    total = sum(part["columns"] * part["loss"] for part in found.values())
    assert total == pytest.approx(1.5)


def text(size):
    return TextFeatures(["a"] * size, torch.randn(size, 8, generator=torch.Generator().manual_seed(0)))


def test_probes_predict_what_training_asks_for():
    """An untrained MARDM says 0: its error of epsilon is the noise; frames keep their shape, padding is no row."""
    lengths = torch.tensor([3, 2])
    latents = Latents(lengths, lengths * 4, values=torch.ones(2, 3, 5))
    mar = MARDM(latent_dim=5, text_dim=8, process=DDPM(10), width=16, feedforward=16, heads=2, mlp_width=8, mlp_depth=1)
    laid_open = probe(mar, latents, text(2))
    assert laid_open.columns(laid_open.clean).shape == (5, 5)
    noise = torch.randn(5, 5, generator=torch.Generator().manual_seed(1))
    output, _ = amplification.step_errors(laid_open.process, laid_open.predict, laid_open.clean, 4, noise)
    torch.testing.assert_close(output, -noise)

    frames = Latents(lengths, lengths, values=torch.ones(2, 3, 5))
    process = DDPM(10, prediction="x0")
    mdm = MDM(frame_dim=5, text_dim=8, process=process, width=16, feedforward=16, layers=1, heads=2)
    laid_open = probe(mdm, frames, text(2))
    assert laid_open.columns(laid_open.clean).shape == (5, 5)
    with torch.no_grad():
        condition, seen = mdm.denoiser.read(text(2))
        expected = mdm.eval().denoiser(laid_open.clean, torch.tensor([4.0]), condition, seen, frames.mask)
    torch.testing.assert_close(laid_open.predict(laid_open.clean, torch.tensor([4.0])), expected)


def test_what_does_not_diffuse_by_ddpm_is_refused():
    lengths = torch.tensor([1])
    flow = MARDM(latent_dim=5, text_dim=8, process=Flow(), width=16, feedforward=16, heads=2, mlp_width=8, mlp_depth=1)
    with pytest.raises(ValueError, match="MARDM doesn't predict by DDPM; choose mdm, motiondiffuse or mardm_ddpm"):
        probe(flow, Latents(lengths, lengths, values=torch.ones(1, 1, 5)), text(1))


def test_noise_is_found_by_direction():
    draw = torch.Generator().manual_seed(0)
    turn = torch.linalg.qr(torch.randn(6, 6, generator=draw, dtype=torch.float64))[0]
    spread = torch.tensor([9.0, 5.0, 3.0, 1.0, 0.5, 0.1], dtype=torch.float64)
    rows = torch.randn(20000, 6, generator=draw, dtype=torch.float64) * spread @ turn.T + 3
    variances, directions = principal(rows)
    torch.testing.assert_close(variances.sqrt(), spread, rtol=0.02, atol=0)
    noise = torch.randn(rows.shape, generator=draw, dtype=torch.float64)
    share = torch.tensor([0.0, 0.25, 0.5, 1.0, 1.0, 1.0], dtype=torch.float64)
    predicted = noise @ directions * share @ directions.T + 0.3 * torch.randn(rows.shape, generator=draw).double()
    torch.testing.assert_close(noise_found(noise, predicted - noise, directions), share, rtol=0, atol=0.02)


def test_bands_double_and_cover_every_direction():
    assert list(bands(263)) == ["1", "2", "3-4", "5-8", "9-16", "17-32", "33-64", "65-128", "129-256", "257-263"]
    assert [i for part in bands(11).values() for i in range(11)[part]] == list(range(11))

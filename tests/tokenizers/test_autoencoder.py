"""A clip's latents and reconstruction are its own, whatever pads it; the losses read the right columns."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from kinema.motion.representation import Representation
from kinema.motion.statistics import Statistics
from kinema.tokenizers import MotionTokenizer
from kinema.tokenizers.autoencoder import AutoEncoder
from kinema.types import MotionBatch

LENGTHS = [40, 23, 9, 4]
WIDTHS = {
    ("essential", "humanml3d"): 67,
    ("redundant", "humanml3d"): 263,
    ("essential", "kit"): 64,
    ("redundant", "kit"): 251,
}


def make(kind="essential", skeleton="humanml3d", **options) -> AutoEncoder:
    torch.manual_seed(0)
    representation = Representation(kind, skeleton)
    rng = np.random.default_rng(0)
    representation.fit(Statistics(rng.normal(size=representation.width), rng.uniform(0.5, 2, representation.width)))
    return AutoEncoder(representation, width=16, latent_dim=8, dropout=0.0, **options).eval()


def batch(width: int, lengths=LENGTHS, seed=0) -> MotionBatch:
    rows = torch.randn(len(lengths), max(lengths), width, generator=torch.Generator().manual_seed(seed))
    counts = torch.tensor(lengths)
    return MotionBatch(rows * (torch.arange(max(lengths)) < counts[:, None])[..., None], counts)


def rows_of(motion: MotionBatch, indices: list[int], size: int) -> MotionBatch:
    return MotionBatch(motion.features[indices, :size], motion.lengths[indices])


@pytest.mark.parametrize(("kind", "skeleton"), WIDTHS)
def test_it_reads_and_writes_the_representations_columns(kind, skeleton):
    model, width = make(kind, skeleton), WIDTHS[kind, skeleton]
    motion = batch(263 if skeleton == "humanml3d" else 251, [20, 12])
    latents = model.encode(motion)
    decoded = model.decode(latents)
    assert isinstance(model, MotionTokenizer)
    assert latents.values.shape == (2, 5, 8)
    assert latents.lengths.tolist() == [5, 3]
    assert decoded.features.shape == (2, 20, width)
    assert decoded.lengths.tolist() == [20, 12]
    assert not decoded.features[1, 12:].any()


def test_padding_changes_nothing():
    model, motion = make(), batch(67)
    together = model.encode(motion)
    decoded = model.decode(together)
    for i, length in enumerate(LENGTHS):
        latents = model.encode(rows_of(motion, [i], length))
        alone = model.decode(latents)
        assert together.lengths[i] == latents.lengths[0] == length // 4
        torch.testing.assert_close(together.values[i, : length // 4], latents.values[0], rtol=1e-5, atol=1e-6)
        torch.testing.assert_close(decoded.features[i, : length // 4 * 4], alone.features[0], rtol=1e-5, atol=1e-5)
        assert not together.values[i, length // 4 :].any()


def test_the_published_padding_leaks_into_the_end():
    model, motion = make(mask_padding=False), batch(67)
    alone = model.decode(model.encode(rows_of(motion, [1], LENGTHS[1]))).features[0]
    together = model.decode(model.encode(motion)).features[1, : len(alone)]
    assert (alone - together).abs().max() > 1e-3


def test_full_windows_cost_no_masking(monkeypatch):
    model, motion = make(), batch(67, [16, 16])
    expected = model.decode(model.encode(motion)).features
    monkeypatch.setattr("kinema.nn.conv.frame_mask", lambda *_: pytest.fail("masked a full batch"))
    torch.testing.assert_close(model.decode(model.encode(motion)).features, expected, rtol=0, atol=0)


def test_the_order_of_a_batch_changes_nothing():
    model, motion = make(), batch(67)
    order = [2, 0, 3, 1]
    torch.testing.assert_close(
        model.encode(rows_of(motion, order, 40)).values, model.encode(motion).values[order], rtol=1e-5, atol=1e-6
    )


def test_frames_that_are_no_whole_latents_are_cut():
    model = make()
    latents = model.encode(batch(67, [20]))
    latents.frames = torch.tensor([18])
    decoded = model.decode(latents)
    assert decoded.lengths.tolist() == [18]
    assert decoded.features[0, 17].any()
    assert not decoded.features[0, 18:].any()


@pytest.mark.parametrize("kind", ["essential", "redundant"])
def test_the_joints_loss_reads_the_joint_positions_only(kind):
    model, motion = make(kind), batch(263, [16, 16])
    losses = model.loss(motion)
    assert list(losses) == ["loss", "reconstruction", "joints"]
    torch.testing.assert_close(losses["loss"], losses["reconstruction"] + losses["joints"])
    target = model.representation.normalize(motion.features)
    output = model.representation.normalize(model.decode(model.encode(motion)).features)
    joints = torch.nn.functional.smooth_l1_loss(output[..., 4:67], target[..., 4:67])
    torch.testing.assert_close(losses["joints"], joints, rtol=1e-4, atol=1e-5)


def test_padding_is_in_no_loss():
    model, motion = make(), batch(67, [40, 20])
    both = [model.loss(rows_of(motion, [i], n))["reconstruction"] for i, n in ((0, 40), (1, 20))]
    torch.testing.assert_close(model.loss(motion)["reconstruction"], (2 * both[0] + both[1]) / 3)


def test_every_weight_learns():
    model = make()
    model.loss(batch(67, [32, 32]))["loss"].backward()
    assert [name for name, p in model.named_parameters() if p.grad is None or not p.grad.any()] == []


def test_too_short_a_clip_is_named():
    with pytest.raises(ValueError, match="motion of 3 frames is too short"):
        make().encode(batch(67, [3]))

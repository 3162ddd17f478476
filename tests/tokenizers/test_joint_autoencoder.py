"""ACMDM's autoencoder sees no later frame and no other joint, and its latents are standardised once it is trained."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import torch

from kinema.data.synthetic.corpus import synthetic_joints
from kinema.motion.features import extract
from kinema.motion.representation import Representation
from kinema.motion.skeleton import HUMANML3D
from kinema.motion.statistics import Statistics
from kinema.nn.causal import CausalConv
from kinema.tokenizers.joint_autoencoder import JointAutoEncoder, scattered
from kinema.types import Latents, MotionBatch

FRAMES = 40


@cache
def clips() -> list[np.ndarray]:
    return [extract(synthetic_joints(5, i, "humanml3d"), HUMANML3D)[:196] for i in range(3)]


def make(**options) -> JointAutoEncoder:
    torch.manual_seed(0)
    form = Representation("essential", "humanml3d").fit(Statistics.compute(clips(), HUMANML3D))
    model = JointAutoEncoder(form, **({"width": 6, "channels": 4, "dropout": 0.5} | options))
    model.prepare(clips())
    return model.eval()


def batch(*lengths: int) -> MotionBatch:
    features = torch.zeros(len(lengths), max(lengths), 67)
    for place, clip, size in zip(features, clips(), lengths, strict=False):
        place[:size] = torch.from_numpy(clip[:size, :67])
    return MotionBatch(features, torch.tensor(lengths))


def reached(output: torch.Tensor, given: torch.Tensor, kept: tuple[int, ...]) -> torch.Tensor:
    """Say along the axes `kept` which parts of what was given a number depends on."""
    (gradient,) = torch.autograd.grad(output.sum(), given, retain_graph=True)
    return gradient.abs().sum(dim=[d for d in range(gradient.ndim) if d not in kept]) > 0


def test_an_output_of_a_strided_convolution_sees_the_last_of_its_frames():
    conv, x = CausalConv(1, 1, 4, stride=2), torch.randn(1, 1, 8, requires_grad=True)
    out = conv(x)
    assert out.shape[2] == 4
    assert reached(out[0, 0, 1], x, (2,)).tolist() == [True] * 4 + [False] * 4


def test_a_latent_sees_its_own_frames_those_before_and_its_own_joint():
    model = make()
    x = torch.randn(1, FRAMES, 22, 3, requires_grad=True)
    z = model.encode_joints(x, torch.tensor([FRAMES])).values.unflatten(2, (22, 4))
    for latent in (0, 4, 9):
        frames = reached(z[0, latent], x, (1,))
        assert not frames[4 * (latent + 1) :].any()
        assert frames[4 * latent : 4 * (latent + 1)].all()
    assert torch.equal(reached(z[0, :, 7], x, (2,)), torch.arange(22) == 7)


def test_a_decoded_joint_sees_its_own_latents_and_no_later_one():
    model = make()
    z = torch.randn(1, 10, 22, 4, requires_grad=True)
    joints = model._decode(z)
    assert joints.shape == (1, 40, 22, 3)
    for frame in (0, 17, 39):
        latents = reached(joints[0, frame], z, (1,))
        assert latents[frame // 4]
        assert not latents[frame // 4 + 1 :].any()
    assert torch.equal(reached(joints[0, :, 3], z, (2,)), torch.arange(22) == 3)


def test_padding_and_neighbours_change_nothing():
    model, motion = make(), batch(40, 23, 12)
    latents = model.encode(motion)
    assert latents.lengths.tolist() == [10, 5, 3]
    assert latents.frames.tolist() == [40, 20, 12]
    assert not latents.values[~latents.mask].any()
    garbage = latents.values.masked_fill(~latents.mask[..., None], 9.0)
    decoded = model.decode(Latents(latents.lengths, latents.frames, values=garbage))
    for i, (size, frames) in enumerate(zip(latents.lengths, latents.frames, strict=True)):
        own = model.encode(MotionBatch(motion.features[i : i + 1, : motion.lengths[i]], motion.lengths[i : i + 1]))
        torch.testing.assert_close(own.values[0], latents.values[i, :size])
        torch.testing.assert_close(model.decode(own).features[0], decoded.features[i, :frames], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(("statistics", "axes"), [("shared_axis", (0, 1)), ("per_joint", 0)])
def test_once_trained_latents_have_mean_0_and_deviation_1(statistics, axes):
    model = make(statistics=statistics)
    model.train()
    model.finish(clips())
    assert model.training  # and yet nothing was dropped
    model.eval()
    rows = []
    for clip in clips():
        latents = model.encode(MotionBatch(torch.from_numpy(clip)[None], torch.tensor([len(clip)])))
        rows.append(latents.values[0].unflatten(1, (22, 4)))
    values = torch.cat(rows).detach()
    torch.testing.assert_close(values.mean(axes), torch.zeros_like(values.mean(axes)), atol=1e-4, rtol=0)
    spread = values.std(axes, correction=0)
    torch.testing.assert_close(spread, torch.ones_like(spread), atol=1e-3, rtol=0)
    before = model.encode(batch(40)).values
    model.finish(clips())
    assert torch.equal(model.encode(batch(40)).values, before)


def test_standardised_latents_are_decoded_as_they_were_encoded():
    model, motion = make(), batch(40)
    plain = model.decode(model.encode(motion)).features
    model.finish(clips())
    torch.testing.assert_close(model.decode(model.encode(motion)).features, plain, rtol=1e-3, atol=1e-4)


def test_the_loss_is_of_real_frames_and_falls():
    model = make(width=16, dropout=0.0, scatter=False).train()
    motion = batch(40, 23)
    padded = MotionBatch(torch.nn.functional.pad(motion.features, (0, 0, 0, 8)), motion.lengths)
    first = model.loss(motion)["loss"]
    torch.testing.assert_close(model.loss(padded)["loss"], first)
    optimizer = torch.optim.Adam(model.parameters(), lr=3e-3)
    for _ in range(40):
        optimizer.zero_grad()
        loss = model.loss(motion)["loss"]
        loss.backward()
        optimizer.step()
    assert loss < first / 3


def test_windows_are_scattered_in_training_by_the_steps_draws_alone():
    model, motion = make(dropout=0.0), batch(40, 40)

    def loss(seed: int, shard: tuple[int, int] = (0, 1), part: slice = slice(None)) -> torch.Tensor:
        own = MotionBatch(motion.features[part], motion.lengths[part])
        return model.loss(own, generator=torch.Generator().manual_seed(seed), shard=shard)["loss"]

    assert loss(1) == loss(2)
    model.train()
    assert loss(1) == loss(1) != loss(2)
    halves = [loss(1, (rank, 2), slice(rank, rank + 1)) for rank in (0, 1)]
    torch.testing.assert_close(sum(halves) / 2, loss(1))


def test_scattering_turns_and_moves_a_motion_as_a_whole():
    joints = torch.randn(4000, 2, 5, 3, generator=torch.Generator().manual_seed(0))
    noise = torch.randn(4000, 3, generator=torch.Generator().manual_seed(1))
    found = scattered(joints, noise, torch.tensor([2.0, 3.0]))
    torch.testing.assert_close(found[..., 1], joints[..., 1])
    away = lambda x: (x[:, 0, 0] - x[:, 1, 3]).norm(dim=-1)  # noqa: E731
    torch.testing.assert_close(away(found), away(joints), rtol=1e-4, atol=1e-4)
    still = scattered(torch.tensor([0.0, 0.0, 1.0]).expand(4000, 1, 1, 3), noise, torch.zeros(2))[:, 0, 0]
    assert still.mean(0).abs().max() < 0.05  # any way to face
    placed = scattered(torch.zeros(4000, 1, 1, 3), noise, torch.tensor([2.0, 3.0]))[:, 0, 0]
    torch.testing.assert_close(placed.std(0), torch.tensor([2.0, 0.0, 3.0]), rtol=0.05, atol=0.0)


def test_too_short_motion_is_refused():
    with pytest.raises(ValueError, match="motion of 3 frames is too short to encode; give at least 4"):
        make().encode(batch(3))

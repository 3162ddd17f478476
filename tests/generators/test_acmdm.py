"""Test what ACMDM has of its own: patches of joints, its rotary base, where it starts, and what it diffuses."""

from __future__ import annotations

import pytest
import torch

from kinema.diffusion.flow import Flow
from kinema.generators.acmdm import ACMDM
from kinema.generators.acmdm.denoiser import rotary_base
from kinema.types import Known, Latents, TextFeatures, frame_mask

LATENTS = 6


def make(*, started: bool = True, **options) -> ACMDM:
    """Make a tiny model; `started` gives every layer an influence."""
    torch.manual_seed(0)
    sizes = {"joints": 6, "channels": 2, "unit": 4, "patch": 3, "text_dim": 5, "width": 16, "layers": 2, "heads": 2}
    model = ACMDM(process=Flow(), max_frames=32, **(sizes | options))
    if started:
        with torch.no_grad():
            for parameter in model.parameters():
                parameter.add_(0.5 * torch.randn_like(parameter))
    return model.eval()


def text(count: int = 1) -> TextFeatures:
    pooled = torch.randn(count, 5, generator=torch.Generator().manual_seed(1))
    return TextFeatures(["a"] * count, pooled)


def predict(model: ACMDM, x: torch.Tensor, real: torch.Tensor | None = None, time: float = 0.4) -> torch.Tensor:
    condition, seen = model.denoiser.read(text(len(x)))
    return model.denoiser(x, torch.tensor([time]), condition, seen, real)


def test_an_untrained_model_predicts_no_velocity():
    assert not predict(make(started=False), torch.randn(2, LATENTS, 12)).any()


@pytest.mark.parametrize("patch", [6, 3, 2])
def test_every_patch_sees_every_other_of_the_real_latents(patch):
    model, x = make(patch=patch), torch.randn(1, LATENTS, 12, requires_grad=True)
    out = predict(model, x, frame_mask(torch.tensor([4]), LATENTS))
    (gradient,) = torch.autograd.grad(out[0, 1, :2].sum(), x)
    assert (gradient[0, :4] != 0).all()
    assert not gradient[0, 4:].any()


def test_the_places_of_joints_and_latents_matter():
    model, x = make(), torch.randn(1, LATENTS, 12)
    out = predict(model, x)
    swapped = predict(model, x.unflatten(2, (2, 6)).flip(2).flatten(2)).unflatten(2, (2, 6)).flip(2).flatten(2)
    assert not torch.allclose(swapped, out, atol=1e-3)
    assert not torch.allclose(predict(model, x.flip(1)).flip(1), out, atol=1e-3)


def test_time_and_text_matter():
    model, x = make(), torch.randn(1, LATENTS, 12)
    assert not torch.allclose(predict(model, x, time=0.9), predict(model, x), atol=1e-3)
    condition, _ = model.denoiser.read(model.without_text(text()))
    dropped = model.denoiser(x, torch.tensor([0.4]), condition)
    assert not torch.allclose(dropped, predict(model, x), atol=1e-3)


def test_the_rotary_base_grows_with_the_sequence():
    assert [rotary_base(tokens) for tokens in (39, 40, 49, 196, 539)] == [100.0, 200.0, 200.0, 500.0, 1400.0]
    assert make().denoiser.base == rotary_base(8 * 2)


def test_it_is_for_latents_or_for_frames():
    latents, frames = make().space, make(unit=1).space
    assert (latents.kind, latents.width, latents.most, latents.unit) == ("continuous", 12, 8, 4)
    assert (frames.kind, frames.width, frames.most, frames.unit) == ("frames", 12, 32, 1)


def test_kept_latents_come_back_and_frames_are_counted_in_frames():
    model = make()
    values = torch.randn(2, LATENTS, 12)
    lengths = torch.tensor([6, 4])
    mask = frame_mask(lengths, LATENTS) & (torch.arange(LATENTS) != 2)
    known = Known(Latents(lengths, 4 * lengths, values=values * mask[..., None]), mask)
    made = model.sample(text(2), None, seeds=torch.tensor([1, 2]), known=known)
    assert torch.equal(made.frames, 4 * lengths)
    assert torch.equal(made.values[mask], values[mask])
    assert made.values[:, 2].any()


def test_bad_choices_are_named():
    with pytest.raises(ValueError, match="patch=4 does not divide 6 joints; choose one of 1, 2, 3, 6"):
        make(patch=4)
    with pytest.raises(ValueError, match="divide the width into even parts"):
        make(heads=3)
    wrong = Latents(torch.tensor([2]), torch.tensor([8]), values=torch.zeros(1, 2, 11))
    with pytest.raises(ValueError, match="values of 12 channels"):
        make().loss(wrong, text())

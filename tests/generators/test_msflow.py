"""Test what MSFlow has of its own: masks, groups of frames, null tokens, its refiner and where it starts."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from kinema.diffusion.flow import Flow
from kinema.generators.frames.training import FrameDraws
from kinema.generators.msflow import MSFlow, Physics
from kinema.generators.msflow.masks import sees
from kinema.generators.msflow.refiner import Refiner, masked_mean
from kinema.motion.representation import Representation
from kinema.motion.skeleton import get_skeleton
from kinema.motion.statistics import Statistics
from kinema.tokenizers.frames import FrameGroups, Frames
from kinema.types import Latents, TextFeatures, frame_mask

FRAMES = 12


def make(*, started: bool = True, **options) -> MSFlow:
    """Make a tiny model; `started` gives every layer an influence."""
    torch.manual_seed(0)
    sizes = {"frame_dim": 6, "token_dim": 7, "width": 16, "feedforward": 24, "layers": 2, "heads": 2, "max_frames": 16}
    model = MSFlow(process=Flow(prediction="x1", source_scale=5.0), **(sizes | options))
    if started:
        for parameter in model.parameters():
            torch.nn.init.normal_(parameter, std=0.25)
    return model.eval()


def text(counts: list[int]) -> TextFeatures:
    generator = torch.Generator().manual_seed(1)
    seen = frame_mask(torch.tensor(counts), max(counts))
    tokens = torch.randn(len(counts), max(counts), 7, generator=generator) * seen[..., None]
    return TextFeatures(["a"] * len(counts), tokens.mean(dim=1), tokens, seen)


def predict(model: MSFlow, x: torch.Tensor, words: TextFeatures, real: torch.Tensor | None = None) -> torch.Tensor:
    condition, seen = model.denoiser.read(words)
    return model.denoiser(x, torch.tensor([0.4]), condition, seen, real)


def test_an_untrained_model_predicts_the_mean_motion():
    x = torch.randn(2, FRAMES, 6)
    assert not predict(make(started=False), x, text([3, 5])).any()


def test_an_untrained_refiner_changes_no_word():
    refiner = Refiner(8, 2, 2)
    refiner.reset_parameters()
    words = torch.randn(2, 5, 8)
    assert torch.equal(refiner(words, frame_mask(torch.tensor([5, 2]), 5), torch.tensor([0.3])), words)


@pytest.mark.parametrize(("attention", "patch", "block"), [("joint", 1, 1), ("joint", 2, 2), ("cross", 1, 3)])
def test_causal_motion_sees_its_own_block_and_what_was_before(attention, patch, block):
    model = make(mask="causal", mask_block=block, patch=patch, text_attention=attention)
    x = torch.randn(1, FRAMES, 6, requires_grad=True)
    size = patch * block
    out = predict(model, x, text([4]))
    for frame in (0, 5, FRAMES - 1):
        (gradient,) = torch.autograd.grad(out[0, frame].sum(), x, retain_graph=True)
        reached = gradient[0].abs().sum(dim=1) > 0
        expected = torch.arange(FRAMES) < (frame // size + 1) * size
        assert torch.equal(reached, expected)


def test_causal_text_sees_no_motion():
    mask = sees(torch.ones(1, 3, dtype=torch.bool), torch.ones(1, 4, dtype=torch.bool), causal=True)
    assert mask.shape == (1, 1, 7, 7)
    assert mask[0, 0, :3, :3].all()
    assert not mask[0, 0, :3, 3:].any()
    assert mask[0, 0, 3:, :3].all()
    assert torch.equal(mask[0, 0, 3:, 3:], torch.ones(4, 4).tril().bool())


def test_nobody_sees_padding():
    mask = sees(frame_mask(torch.tensor([2]), 3), frame_mask(torch.tensor([3]), 4))
    assert mask[0, 0, 0].tolist() == [True, True, False, True, True, True, False]


def test_every_frame_of_both_masks_is_seen_by_the_first():
    model = make()
    x = torch.randn(1, FRAMES, 6, requires_grad=True)
    (gradient,) = torch.autograd.grad(predict(model, x, text([4]))[0, 0].sum(), x)
    assert (gradient[0].abs().sum(dim=1) > 0).all()


@pytest.mark.parametrize("patch", [2, 4])
def test_frames_of_a_group_that_are_padding_are_not_read(patch):
    """End the motion inside a group: garbage behind it changes nothing before it."""
    model, words = make(patch=patch), text([3])
    x, garbage = torch.randn(1, FRAMES, 6), torch.full((1, FRAMES, 6), 50.0)
    real = frame_mask(torch.tensor([FRAMES - 1]), FRAMES)
    other = torch.where(real[..., None], x, garbage)
    a, b = predict(model, x, words, real), predict(model, other, words, real)
    torch.testing.assert_close(a[:, :-1], b[:, :-1])


def test_place_in_time_matters():
    model = make()
    x = torch.randn(1, 8, 6)
    first = predict(model, x, text([3]))
    assert not torch.allclose(predict(model, x.flip(1), text([3])).flip(1), first, atol=1e-4)


def test_an_untimed_refiner_reads_the_text_once():
    timed, once = make(), make(refiner_timed=False)
    words, x, times = text([4]), torch.randn(1, FRAMES, 6), torch.tensor([0.2])
    assert torch.equal(timed.denoiser.read(words)[0], timed.denoiser.words(words)[0])
    refined, mask = once.denoiser.read(words)
    assert not torch.equal(refined, once.denoiser.words(words)[0])
    calls = []
    once.denoiser.refiner.register_forward_hook(lambda *_: calls.append(1))
    once.denoiser(x, times, refined, mask)
    assert calls == []


def test_null_tokens_hide_how_long_the_text_was():
    model = make(null_tokens=3)
    x = torch.randn(2, FRAMES, 6)[:1].expand(2, -1, -1)
    out = predict(model, x, model.without_text(text([6, 2])))
    torch.testing.assert_close(out[0], out[1])
    assert not torch.allclose(predict(model, x, text([6, 2]))[0], out[0], atol=1e-3)


def test_as_published_a_dropped_text_still_shows_its_length():
    model = make()
    x = torch.randn(2, FRAMES, 6)[:1].expand(2, -1, -1)
    out = predict(model, x, model.without_text(text([6, 2])))
    assert not torch.allclose(out[0], out[1], atol=1e-3)


def test_some_texts_of_a_batch_are_dropped():
    for model in (make(null_tokens=2), make()):
        words = text([4, 4])
        x = torch.randn(2, FRAMES, 6)
        drop = torch.tensor([True, False])
        out = predict(model, x, model.without_text(words, drop))
        torch.testing.assert_close(out[:1], predict(model, x, model.without_text(words))[:1])
        torch.testing.assert_close(out[1:], predict(model, x, words)[1:])


def test_more_draws_for_a_motion_are_as_many_motions():
    one, many = make(), make(batch_multiplier=3).train()
    x1, words = torch.randn(2, FRAMES, 6), text([3, 5])
    lengths = torch.tensor([FRAMES, 7])
    drawn = many._draw(x1.repeat_interleave(3, dim=0), torch.Generator().manual_seed(2), (0, 1))
    assert len(drawn.time.unique()) == 6
    found = many.loss(Latents(lengths=lengths, frames=lengths, values=x1), words, draws=drawn)["loss"]
    rows = [
        one.loss(
            Latents(lengths=lengths[i : i + 1], frames=lengths[i : i + 1], values=x1[i : i + 1]),
            TextFeatures(["a"], words.pooled[i : i + 1], words.tokens[i : i + 1], words.token_mask[i : i + 1]),
            draws=drawn.crop(slice(3 * i + k, 3 * i + k + 1)),
        )["loss"]
        for i in range(2)
        for k in range(3)
    ]
    torch.testing.assert_close(found, torch.stack(rows).mean())
    lone = Latents(lengths=lengths, frames=lengths, values=x1)
    assert len(many.eval()._repeated(lone.lengths, x1, words)[0]) == 2  # validation sees each motion once


def test_masked_mean_of_nothing_is_zero():
    assert not masked_mean(torch.randn(1, 3, 4), torch.zeros(1, 3, dtype=torch.bool)).any()


def test_the_published_size_has_its_parameters():
    """Count what the paper prints, 68.77 M (FRONTIER §2.2), of which the text's end of the last block does nothing."""
    width, hidden = 512, 682
    with torch.device("meta"):
        model = MSFlow(process=Flow(), frame_dim=263, token_dim=768)
    idle = width * width + 128 + (width + 1) * width + width + 3 * width * hidden + 4 * width * (width + 1)
    assert sum(p.numel() for p in model.parameters()) + idle == 68_772_103


def test_bad_choices_are_named():
    with pytest.raises(ValueError, match=r"mask.*bidirectional"):
        make(mask="forward")
    with pytest.raises(ValueError, match=r"text_attention.*joint"):
        make(text_attention="self")
    with pytest.raises(ValueError, match="divide the width into even parts"):
        make(heads=3)
    with pytest.raises(ValueError, match=r"reads_tokens: true"):
        make().denoiser.read(TextFeatures(["a"], torch.zeros(1, 5)))


class Unasked:
    """Latents of which nothing is asked."""

    def range(self) -> tuple[torch.Tensor, torch.Tensor]:
        raise AssertionError("no range is needed")


def physical(**weights) -> MSFlow:
    """Make a model on essential frames with penalties, and the tokenizer's joints."""
    representation = Representation("essential", "humanml3d")
    width = representation.width
    representation.fit(Statistics(np.zeros(width), np.ones(width)))
    model = make(frame_dim=width, max_frames=32, physics=Physics(**weights))
    model.prepare(Frames(representation), Unasked())
    return model


def motion(frames: int = 20) -> Latents:
    values = torch.randn(2, frames, 67, generator=torch.Generator().manual_seed(3)) * 0.1
    lengths = torch.tensor([frames, frames - 6])
    return Latents(lengths, lengths, values=values * frame_mask(lengths, frames)[..., None])


def test_penalties_of_the_motion_itself_are_those_of_its_feet():
    joints = physical(steps=1.0).place(motion().values)
    real, skeleton = motion().mask, get_skeleton("humanml3d")
    assert not Physics(steps=1.0, bones=1.0).penalties(joints, joints, real, skeleton).any()


def test_penalties_count_centimetres_of_real_frames():
    joints, real = physical(steps=1.0).place(motion().values), motion().mask
    skeleton = get_skeleton("humanml3d")
    jump = joints.clone()
    jump[:, 10:] += torch.tensor([0.02, 0.0, 0.0])  # 2 cm in one step, bones and all
    found = Physics(steps=3.0, bones=1.0).penalties(jump, joints, real, skeleton)
    torch.testing.assert_close(found[:, 9], torch.full((2,), 3 * 4 / 3), rtol=1e-3, atol=1e-3)
    assert found[:, [8, 10]].abs().max() < 1e-3
    behind = joints.clone()
    behind[1, 14:] += 50.0  # padding
    assert not Physics(steps=1.0, bones=1.0, feet=1.0).penalties(behind, joints, real, skeleton)[1, 14:].any()


def test_feet_that_stand_in_the_data_must_not_slide():
    skeleton = get_skeleton("humanml3d")
    joints = torch.zeros(1, 6, skeleton.num_joints, 3)
    slid = joints.clone()
    slid[:, :, skeleton.feet_left[1], 0] = torch.arange(6) * 0.03
    real = torch.ones(1, 6, dtype=torch.bool)
    found = Physics(feet=1.0).penalties(slid, joints, real, skeleton)
    torch.testing.assert_close(found[0], torch.tensor([4.5] * 5 + [0.0]))
    lifted = joints + torch.tensor([0.0, 0.5, 0.0])
    assert not Physics(feet=1.0).penalties(slid, lifted, real, skeleton).any()


def test_penalties_enter_the_loss_and_reach_the_network():
    plain, held = physical(), physical(steps=0.1, feet=0.1)
    assert plain.physics is None
    draws = FrameDraws.draw(
        (2, 20, 67),
        plain.process,
        condition_drop=0.0,
        generator=torch.Generator().manual_seed(0),
        device=torch.device("cpu"),
    )
    losses = [model.loss(motion(), text([4, 3]), draws=draws)["loss"] for model in (plain, held)]
    assert losses[1] > losses[0]
    losses[1].backward()
    assert held.denoiser.motion_in.weight.grad.any()


def test_penalties_need_a_clean_prediction_and_joints():
    with pytest.raises(ValueError, match="with prediction x1"):
        MSFlow(process=Flow(), frame_dim=6, token_dim=7, width=16, heads=2, physics=Physics(steps=1.0))
    with pytest.raises(ValueError, match=r"call prepare\(tokenizer, latents\)"):
        make(frame_dim=67, max_frames=32, physics=Physics(steps=1.0)).loss(motion(), text([4, 3]))
    with pytest.raises(ValueError, match="places no joints"):
        FrameGroups(Representation("essential", "humanml3d"), unit=4, latent_dim=4 * 67).joints(torch.zeros(1, 2, 268))

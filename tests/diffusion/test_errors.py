"""Test averages of errors over padded sequences."""

from __future__ import annotations

import torch

from kinema.diffusion.ddpm import DDPM
from kinema.diffusion.errors import per_frame, per_sequence
from kinema.types import frame_mask

LENGTHS = torch.tensor([2, 5])
MASK = frame_mask(LENGTHS, 5)


def test_sequences_weigh_alike_or_by_their_frames():
    errors = torch.zeros(2, 5, 3)
    errors[0], errors[1] = 1.0, 8.0
    assert per_sequence(errors, MASK).tolist() == [1.0, 8.0]
    assert per_frame(errors, MASK).mean().item() == 6.0


def test_padding_never_counts():
    errors = torch.rand(2, 5, 3)
    spoilt = errors.masked_fill(~MASK[:, :, None], torch.nan)
    torch.testing.assert_close(per_sequence(spoilt, MASK), per_sequence(errors, MASK))
    torch.testing.assert_close(per_frame(spoilt, MASK), per_frame(errors, MASK))
    torch.testing.assert_close(per_sequence(errors, MASK)[0], errors[0, :2].mean())


def test_without_padding_all_averages_are_the_loss():
    x1, noise, t = torch.randn(2, 5, 3), torch.randn(2, 5, 3), torch.tensor([3, 30])
    process = DDPM()
    errors, loss = (f(lambda x, t: 0.5 * x, x1, t, noise) for f in (process.errors, process.loss))
    mask = torch.ones(2, 5, dtype=torch.bool)
    torch.testing.assert_close(per_sequence(errors, mask), loss)
    torch.testing.assert_close(per_frame(errors, mask).mean(), loss.mean())

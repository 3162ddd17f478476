"""Groups of frames are the frames, four to a latent, and nothing is lost but a tail."""

from __future__ import annotations

import pytest
import torch

from kinema.data.datasets import ClipDataset
from kinema.motion.representation import Representation
from kinema.motion.statistics import Statistics
from kinema.tokenizers.frames import FrameGroups, Frames
from kinema.training.latents import EncodeEachTime, latent_source
from kinema.types import MotionBatch

WIDTH = 263


def representation() -> Representation:
    drawn = torch.rand(2, WIDTH, generator=torch.Generator().manual_seed(0)).numpy() + 0.5
    return Representation("redundant", "humanml3d").fit(Statistics(drawn[0], drawn[1]))


def batch() -> MotionBatch:
    lengths = torch.tensor([23, 40, 4])
    features = torch.randn(3, 40, WIDTH, generator=torch.Generator().manual_seed(1))
    return MotionBatch(features * (torch.arange(40) < lengths[:, None])[..., None], lengths)


def test_a_latent_is_four_normalised_frames():
    groups, motion = FrameGroups(representation(), unit=4, latent_dim=4 * WIDTH), batch()
    latents, frames = groups.encode(motion), Frames(groups.representation).encode(motion)
    assert latents.lengths.tolist() == [5, 10, 1]
    assert latents.frames.tolist() == [20, 40, 4]
    for row, count in enumerate(latents.lengths.tolist()):
        laid = latents.values[row, :count].reshape(4 * count, WIDTH)
        assert torch.equal(laid, frames.values[row, : 4 * count])
        assert not latents.values[row, count:].any()


def test_decoding_undoes_encoding():
    groups, motion = FrameGroups(representation(), unit=4, latent_dim=4 * WIDTH), batch()
    decoded = groups.decode(groups.encode(motion))
    assert decoded.lengths.tolist() == [20, 40, 4]
    expected = motion.features * decoded.mask[..., None]
    torch.testing.assert_close(decoded.features, expected, rtol=1e-5, atol=1e-5)


def test_copies_of_the_motion_are_never_cached(tmp_path):
    clips: list[ClipDataset] = []
    for tokenizer in (FrameGroups(representation(), unit=4, latent_dim=4 * WIDTH), Frames(representation())):
        assert isinstance(latent_source(tmp_path / "latents", tokenizer, clips, "cpu"), EncodeEachTime)
    assert not (tmp_path / "latents").exists()


def test_a_width_that_is_no_group_is_named():
    with pytest.raises(ValueError, match="latent_dim=263 is not unit x width = 4 x 263 = 1052"):
        FrameGroups(representation(), unit=4, latent_dim=WIDTH)

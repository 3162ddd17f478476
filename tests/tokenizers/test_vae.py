"""Test MLD's autoencoder: its posterior, its loss on both skeletons, what it refuses (numbers: tests/parity)."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from kinema.motion.representation import Representation
from kinema.motion.skeleton import get_skeleton
from kinema.motion.statistics import Statistics
from kinema.tokenizers.posterior import draw
from kinema.tokenizers.vae import VAE
from kinema.types import Latents, MotionBatch

LENGTHS = torch.tensor([9, 14, 12])


def make(skeleton: str = "humanml3d", kind: str = "redundant", **options) -> VAE:
    torch.manual_seed(0)
    width = get_skeleton(skeleton).feature_width
    meters = get_skeleton(skeleton).meters
    statistics = Statistics(np.full(width, 0.1 / meters), np.full(width, 0.2 / meters))
    sizes = {"latents": 2, "width": 16, "feedforward": 24, "layers": 3, "heads": 2, "positions": 40}
    return VAE(Representation(kind, skeleton).fit(statistics), **(sizes | options)).eval()


def motion(model: VAE, rows: slice | list[int] = slice(None), size: int = 14) -> MotionBatch:
    values = torch.randn(3, 14, model.representation.width, generator=torch.Generator().manual_seed(1))[rows]
    values = torch.nn.functional.pad(values, (0, 0, 0, size - 14))
    return MotionBatch(model.representation.denormalize(values, LENGTHS[rows]), LENGTHS[rows])


def seeded(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def test_it_draws_with_a_generator_and_gives_the_mean_without():
    model = make()
    moments, batch = model.moments(motion(make())), motion(make())
    mean, log_variance = moments.values.chunk(2, dim=-1)
    assert torch.equal(model.encode(batch).values, mean)
    drawn = model.encode(batch, generator=seeded(1)).values
    assert torch.equal(drawn, model.encode(batch, generator=seeded(1)).values)
    assert not torch.equal(drawn, model.encode(batch, generator=seeded(2)).values)
    noise = torch.randn(mean.shape, generator=seeded(1))
    torch.testing.assert_close(drawn, mean + (log_variance / 2).exp() * noise)
    assert not model.deterministic


def test_ranks_together_draw_what_one_process_draws():
    moments = Latents(LENGTHS * 0 + 2, LENGTHS, torch.randn(3, 2, 8))
    twice = Latents(moments.lengths.repeat(2), LENGTHS.repeat(2), moments.values.repeat(2, 1, 1))
    whole = draw(twice, seeded(3)).values
    for rank in (0, 1):
        assert torch.equal(draw(moments, seeded(3), (rank, 2)).values, whole[3 * rank : 3 * rank + 3])


def test_padding_and_order_change_no_latent_and_no_frame():
    model = make()
    batch, padded, turned = motion(model), motion(model, size=20), motion(model, [2, 0, 1])
    whole = model.encode(batch)
    for other, rows in ((padded, [0, 1, 2]), (turned, [2, 0, 1])):
        latents = model.encode(other)
        torch.testing.assert_close(latents.values, whole.values[rows])
        made, expected = model.decode(latents).features, model.decode(whole).features[rows]
        torch.testing.assert_close(made, expected[:, : made.shape[1]], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("kind", ["redundant", "essential"])
def test_a_corpus_in_millimetres_has_the_losses_of_one_in_metres(kind):
    """KIT's joints count in metres: in its own unit their error would be a thousand times the features'."""
    model = make("kit", kind)
    losses = model.loss(motion(model), generator=seeded(1))
    assert losses["joints"] < 100 * losses["reconstruction"]
    model.kl_weight, model.joint_weight = 10.0, 0.0
    other = model.loss(motion(model), generator=seeded(1))
    torch.testing.assert_close(other["loss"], losses["reconstruction"] + 10 * losses["kl"])


def test_what_does_not_fit_is_refused():
    model = make()
    codes = Latents(LENGTHS, LENGTHS, codes=torch.zeros(3, 2, 1, dtype=torch.long))
    with pytest.raises(ValueError, match=r"decodes values \(samples, 2, 16\), not codes"):
        model.decode(codes)
    with pytest.raises(ValueError, match=r"not values \(3, 1, 16\)"):
        model.decode(Latents(LENGTHS, LENGTHS, torch.zeros(3, 1, 16)))
    with pytest.raises(ValueError, match=r"41 frames exceed positions=40; crop"):
        model.decode(Latents(LENGTHS, LENGTHS + 27, torch.zeros(3, 2, 16)))
    with pytest.raises(ValueError, match=r"38 frames exceed positions=40 less 4 tokens"):
        model.encode(motion(model, size=38))


def test_the_log_variance_can_start_lower():
    wide, narrow = make(), make(log_variance=-4.0)
    (mean, log_variance), (same, lower) = (m.moments(motion(m)).values.chunk(2, dim=-1) for m in (wide, narrow))
    assert torch.equal(mean, same)
    torch.testing.assert_close(lower, log_variance - 4)

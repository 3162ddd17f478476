"""The autoencoder as a VAE: its divergence, what it draws and what it shares with the autoencoder."""

from __future__ import annotations

import numpy as np
import torch
from torch.distributions import Normal, kl_divergence

from kinema.motion.representation import Representation
from kinema.motion.statistics import Statistics
from kinema.tokenizers.autoencoder import AutoEncoder
from kinema.tokenizers.autoencoder_kl import AutoEncoderKL
from kinema.types import MotionBatch

LENGTHS = torch.tensor([40, 23, 9])


def make(kind: type[AutoEncoder] = AutoEncoderKL, **options) -> AutoEncoder:
    torch.manual_seed(0)
    representation = Representation("essential", "humanml3d").fit(Statistics(np.zeros(67), np.ones(67)))
    return kind(representation, width=16, latent_dim=8, dropout=0.0, **options).eval()


def batch() -> MotionBatch:
    rows = torch.randn(3, 40, 67, generator=torch.Generator().manual_seed(0))
    return MotionBatch(rows * (torch.arange(40) < LENGTHS[:, None])[..., None], LENGTHS)


def seeded(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def test_its_divergence_is_that_from_unit_normals_over_real_latents():
    model, motion = make(kl_weight=0.5), batch()
    moments = model.moments(motion)
    mean, log_variance = moments.content.chunk(2, dim=-1)
    each = kl_divergence(Normal(mean, (log_variance / 2).exp()), Normal(0.0, 1.0))
    losses = model.loss(motion, generator=seeded(0))
    torch.testing.assert_close(losses["kl"], each[moments.mask].mean())
    torch.testing.assert_close(losses["loss"], losses["reconstruction"] + losses["joints"] + 0.5 * losses["kl"])


def test_it_draws_with_a_generator_and_gives_the_mean_without():
    model, motion = make(), batch()
    mean, log_variance = model.moments(motion).content.chunk(2, dim=-1)
    assert torch.equal(model.encode(motion).content, mean)
    drawn = model.encode(motion, generator=seeded(1)).content
    assert torch.equal(drawn, model.encode(motion, generator=seeded(1)).content)
    scaled = (drawn - mean) / (log_variance / 2).exp()
    assert scaled.std().item() == torch.randn(scaled.shape, generator=seeded(1)).std().item()


def test_without_variance_it_loses_what_the_autoencoder_loses():
    ours, plain = make(kl_weight=0.0), make(AutoEncoder)
    last = [name for name in plain.encoder.state_dict() if plain.encoder.state_dict()[name].shape[0] == 8]
    state = {name: value[:8] if name in last else value for name, value in ours.encoder.state_dict().items()}
    plain.encoder.load_state_dict(state)
    plain.decoder.load_state_dict(ours.decoder.state_dict())
    with torch.no_grad():
        for name in last:  # a log variance of -60: nothing is drawn but the mean
            tensor = dict(ours.encoder.named_parameters())[name]
            tensor[8:] = -60.0 if name.endswith("bias") else 0.0
    ours_lost, lost = ours.loss(batch(), generator=seeded(0)), plain.loss(batch())
    torch.testing.assert_close(ours_lost["loss"], lost["loss"])

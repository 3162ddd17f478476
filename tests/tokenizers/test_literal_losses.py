"""The losses as the papers' equations have them: L1 (MARDM Eq. 8), and codes that learn by gradients (BAD Eq. 1)."""

from __future__ import annotations

import pytest
import torch
from torch.nn import functional as F

from kinema.motion.representation import Representation
from kinema.motion.statistics import Statistics
from kinema.tokenizers.autoencoder import AutoEncoder
from kinema.tokenizers.codebook import EMACodebook, Quantizer
from kinema.tokenizers.gradient_codebook import GradientCodebook
from kinema.tokenizers.vq import VQVAE
from kinema.types import MotionBatch

NET = {"width": 16, "depth": 1, "dropout": 0.0}


def representation() -> Representation:
    return Representation("essential", "humanml3d").fit(Statistics(torch.zeros(67).numpy(), torch.ones(67).numpy()))


def batch() -> MotionBatch:
    return MotionBatch(torch.randn(2, 16, 67, generator=torch.Generator().manual_seed(1)), torch.tensor([16, 16]))


@pytest.mark.parametrize(("error", "norm"), [("l1", F.l1_loss), ("l2", F.mse_loss), ("smooth_l1", F.smooth_l1_loss)])
def test_the_autoencoder_minimises_the_chosen_error(error, norm):
    torch.manual_seed(0)
    model, motion = AutoEncoder(representation(), latent_dim=8, joint_weight=0.0, error=error, **NET), batch()
    decoded = model.decode(model.encode(motion))
    torch.testing.assert_close(model.loss(motion)["loss"], norm(decoded.features, motion.features))


def test_codes_that_learn_by_gradients_add_the_embedding_term():
    torch.manual_seed(0)
    quantizer = GradientCodebook(12, 8)
    assert isinstance(quantizer, Quantizer)
    model = VQVAE(
        representation(), codebook_size=12, code_dim=8, quantizer=quantizer, joint_weight=0.0, commit_weight=0.25,
        error="l2", **NET,
    ).train()  # fmt: skip
    motion = batch()
    losses = model.loss(motion)
    z = model._encode(motion.features, motion.lengths)
    nearest = quantizer.codebook[torch.cdist(z, quantizer.codebook[None]).argmin(-1)]
    torch.testing.assert_close(losses["embedding"], F.mse_loss(nearest, z))
    torch.testing.assert_close(losses["commit"], F.mse_loss(z, nearest))
    total = losses["reconstruction"] + losses["embedding"] + 0.25 * losses["commit"]
    torch.testing.assert_close(losses["loss"], total)
    losses["loss"].backward()
    used = torch.bincount(model.encode(motion).codes.flatten(), minlength=12) > 0
    assert torch.equal(quantizer.codebook.grad.abs().sum(1) > 0, used)


def test_the_reconstruction_reaches_no_code_and_the_embedding_no_encoder():
    quantizer = GradientCodebook(6, 4)
    z = torch.randn(1, 5, 4, requires_grad=True)
    made = quantizer(z, torch.ones(1, 5, dtype=torch.bool))
    assert torch.autograd.grad(made.values.sum(), quantizer.codebook, retain_graph=True, allow_unused=True) == (None,)
    assert torch.autograd.grad(made.embedding, z, retain_graph=True, allow_unused=True) == (None,)
    assert torch.autograd.grad(made.commit, quantizer.codebook, allow_unused=True) == (None,)


def test_padding_says_nothing():
    quantizer, real = GradientCodebook(6, 4), torch.tensor([[True, True, False]])
    z = torch.randn(1, 3, 4)
    other = z.clone()
    other[0, 2] = 1e6
    for name in ("values", "commit", "embedding", "perplexity", "dead_codes"):
        assert torch.equal(getattr(quantizer(z, real), name), getattr(quantizer(other, real), name))


def test_both_codebooks_look_codes_up_alike():
    codes = torch.tensor([[[1], [-1], [0]]])
    ours, theirs = GradientCodebook(6, 4), EMACodebook(6, 4)
    theirs.start_from(ours.codebooks[0])
    assert torch.equal(ours.lookup(codes), theirs.lookup(codes))
    with pytest.raises(ValueError, match="token id 6 is out of range"):
        ours.lookup(codes + 5)


def test_an_unknown_error_is_named():
    with pytest.raises(ValueError, match="error=l3: must be one of smooth_l1, l1, l2"):
        AutoEncoder(representation(), error="l3")

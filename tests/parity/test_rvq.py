"""The published RVQ-VAE gives its own codes, reconstructions, losses and gradients, whatever layers are active."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from safetensors.torch import load_file
from torch import Tensor

from kinema import interop
from kinema.motion.statistics import Statistics
from kinema.tokenizers.codebook import CodebookDraws
from kinema.types import Latents, MotionBatch

CLOSE = {"rtol": 1e-4, "atol": 1e-5}
LAYERS = 4


@pytest.fixture
def golden(golden_file):
    """Give the golden tensors and the importer's module, in normalised space (mean 0, std 1)."""
    tensors = load_file(golden_file("vq/rvq_momask.safetensors"))
    state = {k.removeprefix("sd."): v for k, v in tensors.items() if k.startswith("sd.")}
    statistics = Statistics(np.zeros(263), np.ones(263))
    model = interop.load("momask-rvq", {"vq_model": state, "ep": 3}, statistics=statistics)
    model.representation.std.fill_(1.0)  # the published variant divides some of them
    return tensors, model


def motion(x: Tensor) -> MotionBatch:
    return MotionBatch(x, torch.full((len(x),), x.shape[1]))


def tokens(codes: Tensor) -> Latents:
    lengths = torch.full((len(codes),), codes.shape[1])
    return Latents(lengths, 4 * lengths, codes=codes)


def test_encode_and_decode(golden):
    tensors, model = golden
    assert model.space.quantizers == LAYERS
    latents = model.encode(motion(tensors["in.x"]))
    assert torch.equal(latents.codes, tensors["out.indices"])
    assert torch.equal(model.encode(motion(tensors["in.x_odd"])).codes, tensors["out.indices_odd"])
    torch.testing.assert_close(model.quantizer.lookup(latents.codes).mT, tensors["out.quantised_sum"], **CLOSE)
    for i in range(LAYERS):
        found = F.embedding(latents.codes[..., i], model.codebooks[i])
        torch.testing.assert_close(found.mT, tensors["out.codes_per_layer"][i], **CLOSE)
    torch.testing.assert_close(model.decode(latents).features, tensors["out.decode"], **CLOSE)


def test_missing_codes_are_zero_vectors(golden):
    tensors, model = golden
    decoded = model.decode(tokens(tensors["in.indices_with_minus1"])).features
    torch.testing.assert_close(decoded, tensors["out.decode_with_minus1"], **CLOSE)
    two = model.decode(tokens(tensors["out.indices"][..., :2])).features
    torch.testing.assert_close(two, tensors["out.decode_two_layers"], **CLOSE)


@pytest.mark.parametrize("active", range(1, LAYERS + 1))
def test_losses_and_gradients(golden, monkeypatch, active):
    tensors, model = golden
    monkeypatch.setattr(type(model.quantizer), "_active", lambda *_: active)
    x, prefix = tensors["in.x"], f"active{active}.out."
    z = model.encoder(x)
    result = model.quantizer(z, torch.ones(z.shape[:2], dtype=torch.bool))
    assert torch.equal(result.codes, tensors[f"{prefix}indices"])
    torch.testing.assert_close(result.values.mT, tensors[f"{prefix}quantised"], **CLOSE)
    rec = tensors[f"{prefix}rec"]
    torch.testing.assert_close(model.decoder(result.values)[: len(rec)], rec, **CLOSE)
    losses = model.loss(motion(x))
    for ours, theirs in (
        ("loss", "loss"),
        ("reconstruction", "loss_rec"),
        ("joints", "loss_velocity"),
        ("commit", "loss_commit"),
        ("perplexity", "perplexity"),
    ):
        torch.testing.assert_close(losses[ours], tensors[f"{prefix}{theirs}"], **CLOSE)
    losses["loss"].backward()
    for weight, theirs in (
        (model.encoder.stem.bias, "encoder.model.0.bias"),
        (model.encoder.head.weight, "encoder.model.4.weight"),
        (model.decoder.stem.weight, "decoder.model.0.weight"),
    ):
        torch.testing.assert_close(weight.grad, tensors[f"{prefix}grad.{theirs}"], **CLOSE)


def test_training_step(golden):
    tensors, model = golden
    quantizer, z = model.quantizer.train(), tensors["train.in.z"].mT
    noise = tensors.get("train.rng.tile_noise")
    draws = [
        CodebookDraws(
            torch.arange(z.shape[0] * z.shape[1]),
            tile_noise=None if noise is None else noise[i],
            uniform=tensors["train.rng.uniform"][i].view(*z.shape[:2], -1),
        )
        for i in range(LAYERS - 1)
    ]
    result = quantizer(z, torch.ones(z.shape[:2], dtype=torch.bool), active=LAYERS - 1, draws=draws)
    assert torch.equal(result.codes, tensors["train.out.indices"])
    torch.testing.assert_close(result.values.mT, tensors["train.out.quantised"], **CLOSE)
    torch.testing.assert_close(result.commit, tensors["train.out.loss_commit"], **CLOSE)
    torch.testing.assert_close(result.perplexity, tensors["train.out.perplexity"], **CLOSE)
    for i, layer in enumerate(quantizer.layers):
        torch.testing.assert_close(layer.codebook, tensors["train.out.codebooks"][i], **CLOSE)
        torch.testing.assert_close(layer.sums, tensors["train.out.sum"][i], **CLOSE)
        torch.testing.assert_close(layer.counts, tensors["train.out.count"][i], **CLOSE)

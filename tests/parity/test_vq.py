"""The published VQ-VAE gives its own codes, reconstructions, losses and gradients; its codebook moves as published."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from torch import Tensor

from kinema import interop
from kinema.motion.representation import Representation
from kinema.motion.statistics import Statistics
from kinema.tokenizers.codebook import CodebookDraws, EMACodebook, tile
from kinema.tokenizers.vq import VQVAE
from kinema.types import Latents, LatentSpace, MotionBatch

CLOSE = {"rtol": 1e-4, "atol": 1e-5}


@pytest.fixture(params=["t2m-gpt-vq", "mmm-vq"])
def golden(request, golden_file):
    """Give the golden tensors and the importer's module, in normalised space (mean 0, std 1)."""
    tensors = load_file(golden_file("vq/vq_t2mgpt.safetensors"))
    state = {k.removeprefix("sd."): v for k, v in tensors.items() if k.startswith("sd.")}
    model = interop.load(request.param, {"net": state}, statistics=Statistics(np.zeros(263), np.ones(263)))
    model.representation.std.fill_(1.0)  # the published variant divides some of them
    return tensors, model


def motion(x: Tensor) -> MotionBatch:
    return MotionBatch(x, torch.full((len(x),), x.shape[1]))


@pytest.mark.parametrize("case", ["", "_odd"])
def test_codes_and_reconstruction(golden, case):
    tensors, model = golden
    x = tensors[f"in.x{case}"]
    torch.testing.assert_close(model.encoder(x).mT, tensors[f"out.encoder{case}"], **CLOSE)
    latents = model.encode(motion(x))
    assert torch.equal(latents.codes[..., 0], tensors[f"out.indices{case}"])
    torch.testing.assert_close(model.decode(latents).features, tensors[f"out.rec{case}"], **CLOSE)


def test_lookup_and_decode(golden):
    tensors, model = golden
    codes = tensors["out.indices"][..., None]
    torch.testing.assert_close(model.quantizer.lookup(codes), tensors["out.dequantised"], rtol=0, atol=0)
    lengths = torch.full((3,), 8)
    decoded = model.decode(Latents(lengths, 4 * lengths, codes=codes))
    torch.testing.assert_close(decoded.features, tensors["out.decoder_of_indices"], **CLOSE)


def test_losses_and_gradients(golden):
    tensors, model = golden
    losses = model.loss(motion(tensors["in.x"]))
    for ours, theirs in (
        ("loss", "loss"),
        ("reconstruction", "loss_rec"),
        ("joints", "loss_velocity"),
        ("commit", "loss_commit"),
        ("perplexity", "perplexity"),
    ):
        torch.testing.assert_close(losses[ours], tensors[f"out.{theirs}"], **CLOSE)
    losses["loss"].backward()
    for weight, theirs in (
        (model.encoder.stem.weight, "encoder.model.0.weight"),
        (model.encoder.head.weight, "encoder.model.4.weight"),
        (model.decoder.stem.weight, "decoder.model.0.weight"),
        (model.decoder.head.bias, "decoder.model.6.bias"),
    ):
        torch.testing.assert_close(weight.grad, tensors[f"out.grad.vqvae.{theirs}"], **CLOSE)


@pytest.mark.parametrize(
    ("kind", "size", "dim", "count"), [("t2m-gpt-vq", 512, 512, 19.437), ("mmm-vq", 8192, 32, 17.962)]
)
def test_published_sizes_load(kind, size, dim, count):
    quantizer = EMACodebook(size, dim)
    features = Representation("redundant", "humanml3d")
    ours = VQVAE(features, codebook_size=size, code_dim=dim, quantizer=quantizer)
    state = {theirs: ours.state_dict()[name] for theirs, name in names().items()}
    assert len(state) == 67
    model = interop.load(kind, {"net": state})
    assert model.space == LatentSpace("codes", dim, 49, 4, size)
    assert model.quantizer.reset == ("unused" if kind == "mmm-vq" else "always")
    assert round(sum(p.numel() for p in model.parameters()) / 1e6, 3) == count


def names() -> dict[str, str]:
    """Give the published names of all tensors and ours, as STATE_DICTS lists them."""
    found = {"vqvae.quantizer.codebook": "quantizer.codebook"}
    pairs = [
        ("encoder.model.0", "encoder.stem"),
        ("encoder.model.4", "encoder.head"),
        ("decoder.model.0", "decoder.stem"),
    ]
    pairs += [("decoder.model.4", "decoder.mix"), ("decoder.model.6", "decoder.head")]
    for i in range(2):
        pairs += [(f"encoder.model.{i + 2}.0", f"encoder.down.{i}"), (f"decoder.model.{i + 2}.2", f"decoder.up.{i}")]
        for half, place in (("encoder", 1), ("decoder", 0)):
            for b in range(3):
                theirs, ours = f"{half}.model.{i + 2}.{place}.model.{b}", f"{half}.stacks.{i}.blocks.{b}"
                pairs += [(f"{theirs}.conv1", f"{ours}.wide"), (f"{theirs}.conv2", f"{ours}.point")]
    return found | {f"vqvae.{a}.{end}": f"{b}.{end}" for a, b in pairs for end in ("weight", "bias")}


def step(codebook: EMACodebook, x: Tensor, draws: CodebookDraws):
    """Quantise a golden batch (b, d, n) in training mode."""
    z = x.mT
    return codebook(z, torch.ones(z.shape[:2], dtype=torch.bool), draws=draws)


def check(codebook: EMACodebook, golden: dict[str, Tensor], case: str, s: int) -> None:
    for ours in ("codebook", "sums", "counts"):
        theirs = golden[f"{case}.out.{ours.removesuffix('s')}"]
        torch.testing.assert_close(getattr(codebook, ours), theirs[s], **CLOSE)


@pytest.mark.parametrize("case", ["full", "tiled"])
def test_variant_a(golden_file, case):
    golden = load_file(golden_file("vq/ema_variant_a.safetensors"))
    size, dim = golden[f"{case}.out.codebook"].shape[1:]
    codebook = EMACodebook(size, dim, reset="always").train()
    for s, x in enumerate(golden[f"{case}.in.x"]):
        noises = () if case == "full" else (golden["tiled.rng.init_noise"], golden["tiled.rng.tile_noise"][s])
        result = step(codebook, x, CodebookDraws(torch.arange(24), *noises))
        assert torch.equal(result.codes[..., 0], golden[f"{case}.out.indices"][s])
        torch.testing.assert_close(result.values.mT, golden[f"{case}.out.straight_through"][s], **CLOSE)
        torch.testing.assert_close(result.commit, golden[f"{case}.out.commit"][s], **CLOSE)
        torch.testing.assert_close(result.perplexity, golden[f"{case}.out.perplexity"][s], **CLOSE)
        check(codebook, golden, case, s)


@pytest.mark.parametrize("case", ["mixed", "tiled"])
def test_variant_b(golden_file, case):
    golden = load_file(golden_file("vq/ema_variant_b.safetensors"))
    part = {k.removeprefix(f"{case}."): v for k, v in golden.items() if k.startswith(f"{case}.")}
    codebook = EMACodebook(16, 4, reset="unused").train()
    for s in range(len(part["out.codebook"])):
        if s == 0:
            x, codes, order = part["in.x_first"], part["out.indices_first"], part["rng.permutation_first"]
            noise = part["rng.tile_noise_first"]
        else:
            x, codes, order = part["in.x"][s - 1], part["out.indices"][s - 1], part["rng.permutation"][s - 1]
            noise = part["rng.tile_noise"][s - 1] if case == "tiled" else None
        result = step(codebook, x, CodebookDraws(order, part["rng.init_noise"], noise))
        assert torch.equal(result.codes[..., 0], codes)
        torch.testing.assert_close(result.commit, part["out.commit"][s], **CLOSE)
        check(codebook, golden, case, s)
        assert torch.equal(codebook.used, part["out.usage"][s].bool())
        assert codebook.counter == part["out.reset_count"][s]


def test_the_noise_of_repeated_rows(golden_file):
    golden = load_file(golden_file("vq/ema_variant_a.safetensors"))
    rows = golden["tiled.in.x"][0].mT.flatten(0, 1)
    first = tile(rows, 20, golden["tiled.rng.init_noise"])
    assert first.shape == (24, 16)
    assert 0 < (first - rows.repeat(3, 1)).abs().max() < 0.02

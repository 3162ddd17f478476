"""The published MARDM autoencoders give their own latents, reconstructions, losses and gradients."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from kinema import interop
from kinema.motion.statistics import Statistics
from kinema.types import Latents, LatentSpace, MotionBatch

CLOSE = {"rtol": 1e-4, "atol": 1e-5}


@pytest.fixture(params=["t2m", "kit"])
def golden(request, golden_file):
    """Give the golden tensors and the importer's module, in normalised space (mean 0, std 1)."""
    tensors = load_file(golden_file(f"mardm/mardm_ae_{request.param}.safetensors"))
    state = {k.removeprefix("sd."): v for k, v in tensors.items() if k.startswith("sd.")}
    width = tensors["in.x"].shape[-1]
    return tensors, interop.load(
        "mardm-ae", {"ae": state, "ep": 50}, statistics=Statistics(np.zeros(width), np.ones(width))
    )


@pytest.mark.parametrize(("name", "width"), [("AE t2m", 67), ("AE kit", 64)])
def test_the_published_sizes_load(golden_file, name, width):
    manifest = json.loads(golden_file("mardm/mardm_state_dict_manifest.json").read_text())
    (shapes,) = (v for k, v in manifest.items() if k.startswith(name))
    module = interop.load("mardm-ae", {"ae": {k: torch.zeros(shape) for k, shape in shapes.items()}})
    assert module.representation.width == width
    assert module.space == LatentSpace("continuous", 512, 49, 4)
    if width == 67:
        assert sum(p.numel() for p in module.parameters()) == 18_834_499


def motion(x: torch.Tensor) -> MotionBatch:
    return MotionBatch(x, torch.full((len(x),), x.shape[1]))


@pytest.mark.parametrize(("given", "wanted"), [("in.x", "out.z"), ("in.x_len23", "out.z_len23")])
def test_encode(golden, given, wanted):
    tensors, model = golden
    torch.testing.assert_close(model.encode(motion(tensors[given])).values.mT, tensors[wanted], **CLOSE)


def test_decode(golden):
    tensors, model = golden
    count = tensors["in.z"].shape[2]
    lengths = torch.full((len(tensors["in.z"]),), count)
    decoded = model.decode(Latents(lengths, 4 * lengths, values=tensors["in.z"].mT))
    torch.testing.assert_close(decoded.features, tensors["out.dec"], **CLOSE)


def test_reconstruction(golden):
    tensors, model = golden
    torch.testing.assert_close(
        model.decode(model.encode(motion(tensors["in.x"]))).features, tensors["out.rec"], **CLOSE
    )


def test_losses_and_gradients(golden):
    tensors, model = golden
    losses = model.loss(motion(tensors["in.x_loss"]))
    losses["loss"].backward()
    for name, wanted in (("loss", "out.loss"), ("reconstruction", "out.loss_rec"), ("joints", "out.loss_joints")):
        torch.testing.assert_close(losses[name], tensors[wanted], **CLOSE)
    for weight, wanted in (
        (model.encoder.stem.weight, "out.grad.encoder.model.0.weight"),
        (model.decoder.head.weight, "out.grad.decoder.model.6.weight"),
    ):
        torch.testing.assert_close(weight.grad, tensors[wanted], **CLOSE)

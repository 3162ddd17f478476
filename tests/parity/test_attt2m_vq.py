"""AttT2M's published tokenizer gives its own nodes, mask, part tokens, codes, reconstruction and losses."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from kinema import interop
from kinema.motion.representation import Representation
from kinema.motion.statistics import PUBLISHED_DIVISOR, Statistics
from kinema.tokenizers.body_parts import BodyPartEncoder
from kinema.tokenizers.vq import VQVAE
from kinema.types import MotionBatch

CLOSE = {"rtol": 1e-4, "atol": 1e-5}


@pytest.fixture(scope="module")
def tensors(golden_file):
    return load_file(golden_file("vq/attt2m_vq.safetensors"))


@pytest.fixture
def model(tensors):
    """Give the importer's module in normalised space (mean 0, std 1 once the published variant has divided it)."""
    state = {k.removeprefix("sd."): v for k, v in tensors.items() if k.startswith("sd.")}
    std = np.ones(263)
    std[[0, 1, 2, 3, *range(259, 263)]] = PUBLISHED_DIVISOR
    return interop.load("attt2m-vq", {"net": state}, statistics=Statistics(np.zeros(263), std))


def test_the_growth_of_the_dilations_is_an_option_of_encoder_and_decoder(tensors, model):
    state = {k.removeprefix("sd."): v for k, v in tensors.items() if k.startswith("sd.")}
    std = np.ones(263)
    other = interop.load("attt2m-vq", {"net": state}, statistics=Statistics(np.zeros(263), std), dilation_growth=2)

    def dilations(part):
        return {layer.dilation[0] for layer in part.modules() if isinstance(layer, torch.nn.Conv1d)} - {1}

    for name in ("encoder", "decoder"):
        assert dilations(getattr(model, name)) == {3, 9}
        assert dilations(getattr(other, name)) == {2, 4}


@pytest.fixture
def motion(tensors):
    return MotionBatch(tensors["in.x"], torch.full((2,), 24))


def test_each_frame_is_read_through_its_parts(tensors, model):
    x = tensors["in.x"][:1]
    torch.testing.assert_close(model.encoder.nodes(x), tensors["out.nodes"], **CLOSE)
    assert torch.equal(model.encoder.mask, tensors["out.spatial_mask_open"])
    torch.testing.assert_close(model.encoder.part_tokens(x), tensors["out.part_tokens"], **CLOSE)


def test_codes_and_reconstruction(tensors, model, motion):
    torch.testing.assert_close(model.encoder(motion.features).mT, tensors["out.encoder"], **CLOSE)
    latents = model.encode(motion)
    assert torch.equal(latents.codes[..., 0], tensors["out.indices"])
    torch.testing.assert_close(model.decode(latents).features, tensors["out.rec"], **CLOSE)


def test_losses(tensors, model, motion):
    losses = model.loss(motion)
    wanted = {name: tensors[f"out.loss_{key}"] for name, key in (("reconstruction", "rec"), ("commit", "commit"))}
    wanted["velocities"] = tensors["out.loss_velocity"]
    wanted["loss"] = wanted["reconstruction"] + 0.5 * wanted["velocities"] + 0.02 * wanted["commit"]
    for name, value in wanted.items():
        torch.testing.assert_close(losses[name], value, **CLOSE)


@pytest.mark.parametrize(("skeleton", "parameters"), [("humanml3d", 20_496_455), ("kit", 20_478_011)])
def test_the_published_size(skeleton, parameters):
    # STATE_DICTS: 20.496M and 20.478M.
    model = VQVAE(Representation("redundant", skeleton), encoder=BodyPartEncoder(skeleton, "redundant"))
    assert sum(p.numel() for p in model.parameters()) == parameters

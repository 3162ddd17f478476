"""Test the MARDM and length-estimator importers on weights of other sizes, written under the published names."""

from __future__ import annotations

import pytest
import torch

from kinema import interop
from kinema.diffusion.ddpm import DDPM
from kinema.diffusion.flow import Flow
from kinema.generators.length import LengthEstimator
from kinema.generators.mar.model import MARDM
from kinema.interop import mardm
from kinema.runs.build import build
from kinema.types import TextFeatures


def make(process) -> MARDM:
    torch.manual_seed(3)
    model = MARDM(
        latent_dim=5, text_dim=7, process=process, width=12, feedforward=20, layers=3, heads=2, mlp_width=9, mlp_depth=4
    )
    for parameter in model.parameters():
        torch.nn.init.normal_(parameter, std=0.2)
    return model.eval()


@pytest.mark.parametrize(("variant", "process"), [("ddpm", DDPM), ("sit", Flow)])
def test_round_trip(variant, process):
    model = make(process())
    wrapped = {"ema_mardm": mardm.export(model), "mardm": {}, "ep": 3}
    copy = interop.load("mardm", wrapped, variant=variant, heads=2)
    assert isinstance(copy.process, process)
    text = TextFeatures(["", ""], torch.randn(2, 7))
    frames, seeds = torch.tensor([20, 12]), torch.tensor([1, 2])
    results = [m.sample(text, frames, seeds=seeds).values for m in (model, copy)]
    assert torch.equal(*results)
    assert build(copy.spec).load_state_dict(copy.state_dict())


def test_options_reach_the_model():
    copy = interop.load("mardm", mardm.export(make(Flow())), variant="sit", heads=3, sampling={"guidance": 2.5})
    assert copy.blocks[0].attention.heads == 3
    assert copy.sampling.guidance == 2.5


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda s: s.pop("cond_emb.bias"), "missing: text_projection.bias"),
        (lambda s: s.update(extra=torch.zeros(1)), "unknown: extra"),
        (lambda s: s.update({"cond_emb.bias": torch.zeros(3)}), "of another shape"),
    ],
)
def test_keys_that_do_not_fit_are_named(damage, message):
    state = mardm.export(make(Flow()))
    damage(state)
    with pytest.raises(ValueError, match=message):
        interop.load("mardm", state, variant="sit", heads=2)


def test_the_variant_has_to_be_told():
    with pytest.raises(ValueError, match="'edm' is unknown; choose one of ddpm, sit"):
        interop.load("mardm", mardm.export(make(Flow())), variant="edm")


def test_length_estimator_of_another_size():
    torch.manual_seed(0)
    model = LengthEstimator(text_dim=9, classes=26).eval()
    state = {k.replace("layers.", "output."): v for k, v in model.state_dict().items()}
    copy = interop.load("length-estimator", {"estimator": state})
    text = torch.randn(4, 9)
    assert torch.equal(copy(text), model(text))

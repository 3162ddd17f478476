"""Test the cascade of a base generator and a residual transformer: generation, edits, options, saving."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from kinema.generators import Generator
from kinema.generators.momask.cascade import Cascade
from kinema.runs import weights as artifacts
from kinema.runs.build import build
from kinema.types import Known, Latents, TextFeatures

CODES = 30
FRAMES = torch.tensor([48, 20, 36])
SEEDS = torch.tensor([11, 12, 13])
SIZES = {"codebook_size": CODES, "code_dim": 6, "text_dim": 5, "width": 16, "feedforward": 24, "layers": 1, "heads": 2}
SPEC = {
    "_target_": "kinema.generators.momask.Cascade",
    "base": {
        "_target_": "kinema.generators.momask.MoMask",
        **SIZES,
        "max_latents": 12,
        "sampling": {"_target_": "kinema.generators.momask.MoMaskSampling", "steps": 4, "top_k": 0.5},
    },
    "residual": {
        "_target_": "kinema.generators.momask.ResidualTransformer",
        **SIZES,
        "max_latents": 12,
        "quantizers": 4,
    },
}
BAMM = {
    "_target_": "kinema.generators.bamm.BAMM",
    **SIZES,
    "max_latents": 12,
    "sampling": {"_target_": "kinema.generators.bamm.BammSampling"},
}


def make(base: dict | None = None) -> Cascade:
    torch.manual_seed(0)
    cascade = build(SPEC | {"base": base or SPEC["base"]})
    for parameter in cascade.parameters():
        if parameter.ndim > 1:
            torch.nn.init.normal_(parameter, std=0.4)
    return cascade.eval()


def text() -> TextFeatures:
    return TextFeatures(["a", "b", "c"], torch.randn(3, 5, generator=torch.Generator().manual_seed(1)))


def latents() -> Latents:
    codes = torch.randint(CODES, (3, 12, 4), generator=torch.Generator().manual_seed(2))
    return Latents(FRAMES // 4, FRAMES, codes=codes)


def test_base_then_residual():
    cascade = make()
    base = cascade.base.sample(text(), FRAMES, seeds=SEEDS)
    result = cascade.sample(text(), FRAMES, seeds=SEEDS)
    assert isinstance(cascade, Generator)
    assert torch.equal(result.codes[..., :1], base.codes)
    assert torch.equal(result.codes, cascade.residual.complete(base, text(), seeds=SEEDS).codes)
    assert (cascade.quantizers, cascade.downsample, cascade.max_latents) == (4, 4, 12)
    assert not cascade.predicts_length


def test_residual_options_reach_the_residual_transformer_alone():
    cascade = make()
    first, other = (
        cascade.sample(
            text(), FRAMES, seeds=SEEDS, sampling=replace(cascade.sampling, residual_guidance=scale, residual_top_k=0.0)
        ).codes
        for scale in (1.0, 4.0)
    )
    assert torch.equal(first[..., 0], other[..., 0])
    assert not torch.equal(first, other)


def test_a_base_may_predict_the_length():
    cascade = make(BAMM)
    base = cascade.base.sample(text(), None, seeds=SEEDS)
    result = cascade.sample(text(), None, seeds=SEEDS)
    assert cascade.predicts_length
    assert torch.equal(result.lengths, base.lengths)
    assert torch.equal(result.codes[..., :1], base.codes)
    assert result.codes[..., 1:][result.mask].any(dim=0).all()


@pytest.mark.parametrize("base", [SPEC["base"], BAMM], ids=["momask", "bamm"])
def test_an_edit_keeps_all_codes_of_what_it_keeps(base):
    source = latents()
    keep = torch.rand(3, 12, generator=torch.Generator().manual_seed(3)) < 0.5
    result = make(base).sample(text(), None, seeds=SEEDS, known=Known(source, keep))
    kept, free = keep & source.mask, ~keep & source.mask
    assert torch.equal(result.codes[kept], source.codes[kept])
    assert not torch.equal(result.codes[free], source.codes[free])


def test_the_loss_is_the_sum_of_both():
    cascade = make()
    losses = cascade.loss(latents(), text(), generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(losses["loss"], losses["base"] + losses["residual"])
    losses["loss"].backward()
    assert all(p.grad is not None for p in cascade.parameters())


def test_saving_and_loading(tmp_path):
    cascade = make()
    artifacts.save(cascade, SPEC, tmp_path / "weights.safetensors")
    copy, _ = artifacts.load(tmp_path / "weights.safetensors")
    results = [m.sample(text(), FRAMES, seeds=SEEDS).codes for m in (cascade, copy)]
    assert torch.equal(*results)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"codebook_size": 8}, "codebook_size is 30 in the base and 8 in the residual transformer"),
        ({"max_latents": 10}, "max_latents is 12 in the base and 10"),
        ({"downsample": 2}, "downsample is 4 in the base and 2"),
    ],
)
def test_parts_that_do_not_fit_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        build(SPEC | {"residual": SPEC["residual"] | options})


def test_a_cascade_is_no_base():
    with pytest.raises(ValueError, match="the base makes 4 codes per position; give one that makes 1"):
        build(SPEC | {"base": SPEC})

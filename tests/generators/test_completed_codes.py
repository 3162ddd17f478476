"""Test generators of base codes that a residual transformer completes: generation, edits, options, refusals."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from kinema.generators.tokens.generator import TokenGenerator
from kinema.generators.tokens.residual import ResidualTransformer
from kinema.runs.build import build
from kinema.types import Known, Latents, LatentSpace, TextFeatures

CODES = 30
FRAMES = torch.tensor([48, 20, 36])
SEEDS = torch.tensor([11, 12, 13])
SIZES = {"codebook_size": CODES, "code_dim": 6, "text_dim": 5, "width": 16, "feedforward": 24, "layers": 1, "heads": 2}
MOMASK = {
    "_target_": "kinema.generators.momask.MoMask",
    **SIZES,
    "max_latents": 12,
    "sampling": {"_target_": "kinema.generators.momask.MoMaskSampling", "steps": 4, "top_k": 0.5},
}
BAMM = {
    "_target_": "kinema.generators.bamm.BAMM",
    **SIZES,
    "max_latents": 12,
    "sampling": {"_target_": "kinema.generators.bamm.BammSampling"},
}
RESIDUAL = {
    "_target_": "kinema.generators.tokens.residual.ResidualTransformer",
    **SIZES,
    "max_latents": 12,
    "quantizers": 4,
}


def make(spec: dict) -> TokenGenerator | ResidualTransformer:
    torch.manual_seed(0)
    model = build(spec)
    for parameter in model.parameters():
        if parameter.ndim > 1:
            torch.nn.init.normal_(parameter, std=0.4)
    return model.eval()


def completed(base: dict = MOMASK) -> TokenGenerator:
    model = make(base)
    model.attach("residual", make(RESIDUAL))
    return model


def test_guidance_that_the_residual_transformer_was_not_trained_for_is_refused():
    model = make(MOMASK)
    model.attach("residual", make(RESIDUAL | {"condition_drop": 0.0}))
    with pytest.raises(ValueError, match="no empty text to be guided from; use residual_guidance=1"):
        model.check_sampling(model.sampling)
    model.check_sampling(replace(model.sampling, residual_guidance=1.0))
    with pytest.raises(ValueError, match="a Linear is no residual transformer"):
        model.attach("residual", torch.nn.Linear(1, 1))


def text() -> TextFeatures:
    return TextFeatures(["a", "b", "c"], torch.randn(3, 5, generator=torch.Generator().manual_seed(1)))


def latents() -> Latents:
    codes = torch.randint(CODES, (3, 12, 4), generator=torch.Generator().manual_seed(2))
    return Latents(FRAMES // 4, FRAMES, codes=codes)


def test_base_then_residual():
    base = make(MOMASK).sample(text(), FRAMES, seeds=SEEDS)
    model = completed()
    result = model.sample(text(), FRAMES, seeds=SEEDS)
    assert torch.equal(result.codes[..., :1], base.codes)
    assert torch.equal(result.codes, make(RESIDUAL).complete(base, text(), seeds=SEEDS).codes)
    assert model.space == LatentSpace("codes", None, 12, 4, CODES, quantizers=4)
    assert make(MOMASK).space.quantizers == 1


def test_a_part_is_no_weight_of_the_generator():
    assert completed().state_dict().keys() == make(MOMASK).state_dict().keys()
    assert sum(1 for _ in completed().parameters()) == sum(1 for _ in make(MOMASK).parameters())


def test_residual_options_reach_the_residual_transformer_alone():
    model = completed()
    first, other = (
        model.sample(
            text(), FRAMES, seeds=SEEDS, sampling=replace(model.sampling, residual_guidance=scale, residual_top_k=0.0)
        ).codes
        for scale in (1.0, 4.0)
    )
    assert torch.equal(first[..., 0], other[..., 0])
    assert not torch.equal(first, other)


def test_a_base_may_predict_the_length():
    base = make(BAMM).sample(text(), None, seeds=SEEDS)
    result = completed(BAMM).sample(text(), None, seeds=SEEDS)
    assert torch.equal(result.lengths, base.lengths)
    assert torch.equal(result.codes[..., :1], base.codes)
    assert result.codes[..., 1:][result.mask].any(dim=0).all()


@pytest.mark.parametrize("base", [MOMASK, BAMM], ids=["momask", "bamm"])
def test_an_edit_keeps_all_codes_of_what_it_keeps(base):
    source = latents()
    keep = torch.rand(3, 12, generator=torch.Generator().manual_seed(3)) < 0.5
    result = completed(base).sample(text(), None, seeds=SEEDS, known=Known(source, keep))
    kept, free = keep & source.mask, ~keep & source.mask
    assert torch.equal(result.codes[kept], source.codes[kept])
    assert not torch.equal(result.codes[free], source.codes[free])


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
        make(MOMASK).attach("residual", make(RESIDUAL | options))


def test_a_part_without_a_use_is_refused_by_name():
    with pytest.raises(ValueError, match="MoMask takes no 'retrieval'; it takes residual"):
        make(MOMASK).attach("retrieval", make(RESIDUAL))

"""Test the importers of MoMask's transformers on weights of other sizes, written under the published names."""

from __future__ import annotations

import pytest
import torch

from kinema import interop
from kinema.generators.momask.model import MoMask
from kinema.generators.tokens.residual import ResidualTransformer
from kinema.interop import momask, momask_residual
from kinema.runs.build import build
from kinema.types import Latents, TextFeatures

SIZES = {"codebook_size": 11, "code_dim": 5, "text_dim": 7, "width": 12, "feedforward": 20, "layers": 3, "heads": 2}
TEXT = TextFeatures(["", ""], torch.randn(2, 7, generator=torch.Generator().manual_seed(1)))
FRAMES, SEEDS = torch.tensor([20, 12]), torch.tensor([1, 2])


def filled(model: torch.nn.Module) -> torch.nn.Module:
    generator = torch.Generator().manual_seed(3)
    for parameter in model.parameters():
        torch.nn.init.normal_(parameter, std=0.3, generator=generator)
    return model.eval()


def make_residual(share_weights: bool = True, quantizers: int = 4) -> ResidualTransformer:
    return filled(ResidualTransformer(**SIZES, quantizers=quantizers, share_weights=share_weights))


def test_round_trip():
    model = filled(MoMask(**SIZES))
    copy = interop.load("momask", {"t2m_transformer": momask.export(model), "ep": 3}, heads=2, sampling={"steps": 4})
    options = {"seeds": SEEDS, "sampling": copy.sampling}
    assert torch.equal(copy.sample(TEXT, FRAMES, **options).codes, model.sample(TEXT, FRAMES, **options).codes)
    assert copy.sampling.steps == 4
    assert build(copy.spec).load_state_dict(copy.state_dict())


@pytest.mark.parametrize("quantizers", [2, 4])
@pytest.mark.parametrize("share_weights", [True, False])
def test_residual_round_trip(share_weights, quantizers):
    model = make_residual(share_weights, quantizers)
    content = {"res_transformer": momask_residual.export(model), "ep": 3}
    copy = interop.load("momask-residual", content, heads=2)
    assert copy.quantizers == quantizers
    assert all(torch.equal(copy.state_dict()[k], v) for k, v in model.state_dict().items())
    base = Latents(FRAMES // 4, FRAMES, codes=torch.arange(10).view(2, 5, 1) % 11)
    results = [m.complete(base, TEXT, seeds=SEEDS).codes for m in (model, copy)]
    assert torch.equal(*results)
    assert build(copy.spec).load_state_dict(copy.state_dict())


def test_separate_tables_are_written_at_half_their_size():
    """The published code doubles the dot products of separate tables; ours hold the double."""
    model = make_residual(share_weights=False)
    torch.testing.assert_close(momask_residual.export(model)["output_proj_weight"] * 2, model.score_tables.detach())


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda s: s.pop("cond_emb.bias"), "missing: encoder.text_projection.bias"),
        (lambda s: s.pop("quant_emb.weight"), "'quant_emb.weight' is missing"),
        (lambda s: s.pop("embed_proj_shared_weight"), "'embed_proj_shared_weight' is missing"),
        (lambda s: s.update(extra=torch.zeros(1)), "unknown: extra"),
        (lambda s: s.update({"cond_emb.bias": torch.zeros(3)}), "of another shape"),
    ],
)
def test_keys_that_do_not_fit_are_named(damage, message):
    state = momask_residual.export(make_residual())
    damage(state)
    with pytest.raises(ValueError, match=message):
        interop.load("momask-residual", state, heads=2)


def test_a_residual_transformer_is_no_base():
    with pytest.raises(ValueError, match=r"'momask': 'token_emb\.weight' is missing"):
        interop.load("momask", momask_residual.export(make_residual()), heads=2)

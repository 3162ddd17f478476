"""Test the importer of MMM on weights of other sizes, written under the published names."""

from __future__ import annotations

import pytest
import torch

from kinema import interop
from kinema.generators.mmm import MMM
from kinema.interop import mmm
from kinema.runs.build import build
from kinema.types import TextFeatures


def make(**options) -> MMM:
    torch.manual_seed(0)
    sizes = {"width": 12, "heads": 3, "feedforward": 20, "cross_layers": 2, "base_layers": 1, "head_layers": 3}
    model = MMM(codebook_size=9, code_dim=4, text_dim=5, token_dim=6, **(sizes | options)).eval()
    for parameter in model.parameters():
        torch.nn.init.normal_(parameter, std=0.3)
    model.set_codebook(torch.randn(9, 4))
    return model


@pytest.mark.parametrize("cross", [0, 1, 2])
def test_round_trip(cross):
    model = make(cross_layers=cross)
    nested = {"trans_base.vqvae.vqvae.encoder.model.0.weight": torch.zeros(3)}
    content = {"trans": {f"module.{k}": v for k, v in (mmm.export(model) | nested).items()}}
    copy = interop.load("mmm", content, heads=3, sampling={"steps": 4})
    assert copy.sampling.steps == 4
    assert copy.max_latents == model.max_latents  # by the table of positions
    assert torch.equal(copy.codebook, model.codebook)
    text = TextFeatures(["", ""], torch.randn(2, 5), torch.randn(2, 7, 6))
    ids, lengths = torch.randint(12, (2, 8)), torch.tensor([8, 3])
    expected = model(ids, text, lengths)
    assert torch.equal(copy(ids, text, lengths), expected)
    rebuilt = build(copy.spec).eval()
    rebuilt.load_state_dict(copy.state_dict())
    assert torch.equal(rebuilt(ids, text, lengths), expected)


def test_published_sizes():
    """Compare with STATE_DICTS: 373 entries, 67 of them the tokenizer's, of which we write the codebook."""
    with torch.device("meta"):
        exported = mmm.export(MMM(codebook_size=8192, code_dim=32, text_dim=512, token_dim=512))
    assert len(exported) == 373 - 66
    assert exported["trans_base.learn_tok_emb.weight"].shape == (3, 32)
    assert exported["trans_base.pos_embed.embed"].shape == (51, 1, 1024)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda s: s.pop("trans_base.cond_emb.bias"), "missing: transformer.text_projection.bias"),
        (lambda s: s.update(extra=torch.zeros(1)), "unknown: extra"),
        (lambda s: s.update({"trans_base.learn_tok_emb.weight": torch.zeros(52, 4)}), "load it as 'bad'"),
        (lambda s: s.pop("trans_base.learn_tok_emb.weight"), "not that of a 'mmm'"),
    ],
)
def test_keys_that_do_not_fit_are_named(damage, message):
    state = mmm.export(make())
    damage(state)
    with pytest.raises(ValueError, match=message):
        interop.load("mmm", {"trans": state}, heads=3)

"""Test the importer of T2M-GPT and AttT2M on weights of other sizes, written under the published names."""

from __future__ import annotations

import pytest
import torch

from kinema import interop
from kinema.generators.gpt.model import T2MGPT
from kinema.interop import gpt
from kinema.runs.build import build
from kinema.types import TextFeatures


def make(seed: int, layers: int, cross_layers: int) -> T2MGPT:
    torch.manual_seed(seed)
    model = T2MGPT(
        codebook_size=9,
        text_dim=7,
        token_dim=6 if cross_layers else None,
        width=12,
        feedforward=20,
        layers=layers,
        cross_layers=cross_layers,
        heads=3,
    )
    for parameter in model.parameters():
        torch.nn.init.normal_(parameter, std=0.3)
    return model.eval()


@pytest.mark.parametrize(
    ("kind", "seed", "layers", "cross_layers"), [("t2m-gpt", 1, 2, 0), ("t2m-gpt", 2, 5, 0), ("attt2m", 3, 4, 3)]
)
def test_round_trip(kind, seed, layers, cross_layers):
    model = make(seed, layers, cross_layers)
    wrapped = {"trans": {f"module.{k}": v for k, v in gpt.export(model).items()}, "iter": 3}
    copy = interop.load(kind, wrapped, heads=3)
    assert not copy.training
    assert copy.space.most == model.space.most  # by the table of positions
    text = TextFeatures(["", ""], torch.randn(2, 7), torch.randn(2, 4, 6))
    ids = torch.randint(9, (2, 11))
    assert torch.equal(copy(ids, text), model(ids, text))
    rebuilt = build(copy.spec)
    rebuilt.load_state_dict(copy.state_dict())
    assert torch.equal(rebuilt.eval()(ids, text), model(ids, text))


@pytest.mark.parametrize(("cross_layers", "entries", "millions"), [(0, 314, 228.4), (2, 354, 254.1)])
def test_the_published_sizes(cross_layers, entries, millions):
    """Count as STATE_DICTS does: our parameters, and two tables of 51 positions that are no parameters here."""
    with torch.device("meta"):
        model = T2MGPT(codebook_size=512, text_dim=512, token_dim=512, cross_layers=cross_layers)
        state = gpt.export(model)
    assert len(state) == entries
    assert state["trans_base.blocks.8.attn.mask"].shape == (1, 1, 51, 51)
    assert "trans_head.blocks.8.mlp.2.weight" in state
    count = sum(p.numel() for p in model.parameters()) + 2 * 51 * 1024
    assert count / 1e6 == pytest.approx(millions, abs=0.05)


def test_options_reach_the_model():
    sampling = {"temperature": 0.0}
    copy = interop.load("attt2m", gpt.export(make(0, 2, 1)), heads=2, words="all", max_latents=20, sampling=sampling)
    assert (copy.blocks[0].attention.heads, copy.words, copy.max_latents) == (2, "all", 20)
    assert copy.sampling.greedy


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda s: s.pop("trans_base.cond_emb.bias"), "not that of a 't2m-gpt': 1 missing: text_projection.bias"),
        (lambda s: s.update(extra=torch.zeros(1)), "unknown: extra"),
        (lambda s: s.update({"trans_head.ln_f.bias": torch.zeros(3)}), "of another shape: norm.bias"),
        (lambda s: s.pop("trans_head.head.weight"), "'trans_head.head.weight' is missing"),
    ],
)
def test_keys_that_do_not_fit_are_named(damage, message):
    state = gpt.export(make(0, 2, 0))
    damage(state)
    with pytest.raises(ValueError, match=message):
        interop.load("t2m-gpt", state, heads=3)

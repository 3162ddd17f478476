"""Test BAD's importer on weights of another size, written under the published names, and on MMM's."""

from __future__ import annotations

import pytest
import torch

from kinema import interop
from kinema.generators.bad.model import BAD
from kinema.interop import bad
from kinema.runs.build import build
from kinema.types import TextFeatures


def make(time_token: bool = True) -> BAD:
    torch.manual_seed(3)
    model = BAD(
        codebook_size=20,
        code_dim=5,
        text_dim=7,
        token_dim=9,
        width=12,
        heads=2,
        feedforward=20,
        cross_layers=2,
        base_layers=1,
        head_layers=3,
        time_token=time_token,
    )
    for parameter in model.parameters():
        torch.nn.init.normal_(parameter, std=0.4)
    model.set_codebook(torch.randn(20, 5))
    return model.eval()


def mmm_state() -> dict[str, torch.Tensor]:
    """Write weights as MMM's file has them: one mask token, no time token, a whole tokenizer inside."""
    state = bad.export(make(time_token=False))
    table = state["trans_base.learn_tok_emb.weight"]
    inside = {"trans_base.vqvae.vqvae.encoder.model.0.bias": torch.zeros(4)}
    return state | {"trans_base.learn_tok_emb.weight": table[:3].clone()} | inside


@pytest.mark.parametrize("time_token", [True, False])
def test_round_trip(time_token):
    model = make(time_token)
    copy = interop.load("bad", {"trans": bad.export(model), "iter": 3}, heads=2)
    text = TextFeatures(["", ""], torch.randn(2, 7), torch.randn(2, 4, 9), torch.ones(2, 4, dtype=torch.bool))
    frames, seeds = torch.tensor([196, 12]), torch.tensor([1, 2])
    results = [m.sample(text, frames, seeds=seeds).codes for m in (model, copy)]
    assert torch.equal(*results)
    assert copy.conditions == 1 + time_token
    assert build(copy.spec).load_state_dict(copy.state_dict())


def test_exported_keys_are_the_published_ones():
    state = bad.export(make())
    assert state["trans_base.pos_embed.embed"].shape == (52, 1, 12)
    assert state["trans_base.cross_att.1.attn.mask"].shape == (1, 1, 52, 77)
    assert state["trans_base.learn_tok_emb.weight"].shape == (52, 5)
    assert state["trans_base.t_embedder.mlp.2.weight"].shape == (12, 12)
    assert len(state) == 381 - 66 - 16 * (7 - 1) - 16 * (9 - 3)  # STATE_DICTS: 66 keys of the tokenizer, 7 + 9 blocks


def test_options_reach_the_model():
    options = {"heads": 3, "direction": "le", "words": "all", "sampling": {"sampler": "cbs"}}
    copy = interop.load("bad", bad.export(make()), **options)
    assert copy.transformer.head_blocks[0].attention.heads == 3
    assert copy.direction == "le"
    assert copy.transformer.words == "all"
    assert copy.sampling.sampler == "cbs"


def test_mmm_becomes_a_start_of_bad():
    state = mmm_state()
    start = interop.load("bad", {"trans": state}, heads=2, from_mmm=True)
    table = state["trans_base.learn_tok_emb.weight"]
    rows = start.transformer.special.weight
    assert rows.shape == (52, 5)
    assert torch.equal(rows[:2], table[:2])
    assert torch.equal(rows[2:], table[2:].expand(50, 5))
    assert start.max_latents == 49


@pytest.mark.parametrize(
    ("state", "options", "message"),
    [
        (mmm_state, {}, "1 mask tokens is MMM's; load it as 'mmm', or with from_mmm=True"),
        (lambda: bad.export(make()), {"from_mmm": True}, "50 mask tokens has BAD's masks; leave from_mmm out"),
        (lambda: bad.export(make()) | {"extra": torch.zeros(1)}, {}, "unknown: extra"),
        (lambda: {"other": torch.zeros(1)}, {}, "'trans_base.learn_tok_emb.weight' is missing"),
    ],
)
def test_what_does_not_fit_is_named(state, options, message):
    with pytest.raises(ValueError, match=message):
        interop.load("bad", state(), heads=2, **options)


def test_the_tokenizer_inside():
    assert list(bad.tokenizer(mmm_state())) == ["vqvae.quantizer.codebook", "vqvae.encoder.model.0.bias"]

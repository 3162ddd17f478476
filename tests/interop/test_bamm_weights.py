"""Test the importer of BAMM on weights of other sizes and both forms, written under the published names."""

from __future__ import annotations

import pytest
import torch

from kinema import interop
from kinema.generators.bamm.model import BAMM
from kinema.interop import bamm
from kinema.runs.build import build


@pytest.mark.parametrize(("norm", "wrapper", "layers"), [("post", "t2m_transformer", 2), ("pre", "trans", 3)])
def test_round_trip(norm, wrapper, layers):
    torch.manual_seed(0)
    model = BAMM(
        codebook_size=9, code_dim=6, text_dim=5, width=12, feedforward=20, layers=layers, heads=3, norm=norm
    ).eval()
    for parameter in model.parameters():
        torch.nn.init.normal_(parameter, std=0.3)
    state = bamm.export(model)
    state["token_emb.weight"][-1] = torch.nan  # MASK, which nothing reads
    copy = interop.load("bamm", {wrapper: state, "ep": 3}, heads=3)
    assert not copy.training
    ids, condition, text = torch.randint(11, (2, 8)), torch.rand(2, 8) < 0.4, torch.randn(2, 5)
    assert torch.equal(copy(ids, text, condition), model(ids, text, condition))
    rebuilt = build(copy.spec)
    rebuilt.load_state_dict(copy.state_dict())
    assert torch.equal(rebuilt.eval()(ids, text, condition), model(ids, text, condition))


@pytest.mark.parametrize(("norm", "entries"), [("post", 108), ("pre", 140)])
def test_the_published_sizes(norm, entries):
    """Count as STATE_DICTS does: our parameters, and the row of MASK."""
    with torch.device("meta"):
        model = BAMM(codebook_size=512, code_dim=512, text_dim=512, norm=norm)
        state = bamm.export(model)
    assert len(state) == entries
    shapes = {k: tuple(state[k].shape) for k in ("token_emb.weight", "output_process.poseFinal.weight")}
    assert shapes == {"token_emb.weight": (515, 512), "output_process.poseFinal.weight": (513, 384)}
    assert (sum(p.numel() for p in model.parameters()) + 512) / 1e6 == pytest.approx(12.05, abs=0.005)


def test_other_weights_are_refused():
    with pytest.raises(ValueError, match=r"'token_emb\.weight' is missing"):
        interop.load("bamm", {"t2m_transformer": {"weight": torch.zeros(3)}})

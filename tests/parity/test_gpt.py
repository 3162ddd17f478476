"""Compare T2M-GPT's and AttT2M's transformers with the published ones: logits, loss and greedy decoding."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from safetensors.torch import load_file

from kinema import interop
from kinema.generators.gpt.model import T2MGPT
from kinema.generators.gpt.sampling import GptSampling
from kinema.generators.gpt.training import GptDraws, corrupt
from kinema.generators.tokens.targets import targets
from kinema.interop import gpt
from kinema.types import Latents, TextFeatures

CLOSE = {"rtol": 1e-4, "atol": 1e-5}
KINDS = {"t2m-gpt": "t2mgpt_transformer", "attt2m": "attt2m_transformer"}
END, POSITIONS = 24, 14


@pytest.fixture(params=KINDS)
def golden(request, golden_file) -> tuple[dict[str, torch.Tensor], T2MGPT]:
    """Give the golden tensors and the importer's module."""
    tensors = load_file(golden_file(f"vq/{KINDS[request.param]}.safetensors"))
    state = {k.removeprefix("sd."): v for k, v in tensors.items() if k.startswith("sd.")}
    options = {"heads": 4, "max_latents": POSITIONS - 1, "words": "all"}
    return tensors, interop.load(request.param, {"trans": state}, **options)


def text(tensors: dict[str, torch.Tensor], size: int | None = None) -> TextFeatures:
    """Give the text features with all positions of the words."""
    pooled, words = tensors["in.text"][:size], tensors.get("in.words")
    mask = None if words is None else torch.ones(words.shape[:2], dtype=torch.bool)
    return TextFeatures([""] * len(pooled), pooled, words, mask)


def test_logits(golden):
    tensors, model = golden
    ids = tensors["in.ids"]
    torch.testing.assert_close(model(ids, text(tensors, 3)), tensors["out.logits"], **CLOSE)
    torch.testing.assert_close(model(ids[:, :0], text(tensors, 3)), tensors["out.logits_no_tokens"], **CLOSE)


@pytest.mark.parametrize("cache", [True, False], ids=["cached", "uncached"])
def test_greedy_decoding(golden, cache):
    """Decode the whole batch at once what was decoded sample by sample."""
    tensors, model = golden
    wanted = tensors["out.greedy_ids"]
    sampling = GptSampling(temperature=0, cache=cache)
    result = model.sample(text(tensors), None, seeds=torch.zeros(len(wanted), dtype=torch.long), sampling=sampling)
    assert torch.equal(result.lengths, (wanted >= 0).sum(dim=1))
    assert torch.equal(result.codes[..., 0], wanted.clamp(min=0)[:, : int(result.lengths.max())])
    if "out.greedy_lens" in tensors:
        assert torch.equal(result.lengths, tensors["out.greedy_lens"])


def test_loss(golden_file):
    tensors = load_file(golden_file("vq/t2mgpt_transformer.safetensors"))
    state = {k.removeprefix("sd."): v for k, v in tensors.items() if k.startswith("sd.")}
    model = interop.load("t2m-gpt", state, heads=4, max_latents=POSITIONS - 1)
    lengths, wanted = tensors["in.lens"], tensors["in.target"]
    codes = torch.where(wanted < END, wanted, 0)[:, :-1]
    draws = GptDraws(tensors["in.keep"], tensors["in.random_ids"])
    assert torch.equal(targets(codes, lengths, END, END + 1), wanted)
    assert torch.equal(corrupt(wanted[:, :-1], draws), tensors["in.ids"])
    for size in (POSITIONS - 1, int(lengths.max())):
        latents = Latents(lengths, 4 * lengths, codes=codes[:, :size, None])
        losses = model.loss(latents, text(tensors, 3), draws=draws)
        torch.testing.assert_close(losses["loss"], tensors["out.loss"], **CLOSE)


def test_export_gives_the_golden_state_again(golden):
    tensors, model = golden
    state = {k.removeprefix("sd."): v for k, v in tensors.items() if k.startswith("sd.")}
    model.base_space = replace(model.base_space, most=POSITIONS - gpt.FURTHER)
    exported = gpt.export(model)
    assert set(exported) == set(state)
    for key in set(state) - {"trans_base.pos_embedding.weight"}:
        torch.testing.assert_close(exported[key], state[key], rtol=0, atol=1e-6)

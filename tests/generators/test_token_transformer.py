"""Test the bidirectional token transformer: embedding, masks, words, gradients and errors."""

from __future__ import annotations

import pytest
import torch

from kinema.generators.tokens.transformer import TokenTransformer, code_losses, with_end
from kinema.types import TextFeatures

CODES, DIM, TEXT, WORD, WIDTH = 11, 3, 5, 7, 16


def make(**options) -> TokenTransformer:
    """Make a tiny model in which everything has an influence."""
    torch.manual_seed(0)
    sizes = {"width": WIDTH, "heads": 2, "feedforward": 24, "cross_layers": 1, "base_layers": 1, "head_layers": 2}
    model = TokenTransformer(
        codebook_size=CODES, code_dim=DIM, specials=3, text_dim=TEXT, token_dim=WORD, **(sizes | options)
    )
    for parameter in model.parameters():
        torch.nn.init.normal_(parameter, std=0.4)
    model.set_codebook(torch.randn(CODES, DIM))
    return model.eval()


def text(words: int = 6) -> TextFeatures:
    generator = torch.Generator().manual_seed(1)
    pooled, tokens = torch.randn(2, TEXT, generator=generator), torch.randn(2, 6, WORD, generator=generator)
    mask = torch.arange(6) < torch.tensor([6, 4])[:, None]
    return TextFeatures(["", ""], pooled, tokens[:, :words], mask[:, :words])


IDS = torch.tensor([[4, 13, 10, 13, 11], [1, 13, 11, 12, 12]])
REAL = torch.tensor([[1, 1, 1, 1, 1], [1, 1, 1, 0, 0]], dtype=torch.bool)
ALL = torch.ones_like(REAL)


@pytest.mark.parametrize("cross_layers", [0, 1])
def test_every_parameter_learns_and_the_codebook_is_none(cross_layers):
    model = make(cross_layers=cross_layers).train()
    model(IDS, text(), REAL).square().sum().backward()
    assert [name for name, p in model.named_parameters() if p.grad is None or not p.grad.any()] == []
    assert "codebook" not in dict(model.named_parameters())
    assert "codebook" in model.state_dict()


def test_codes_are_embedded_by_the_codebook_and_specials_by_learned_rows():
    model = make()
    rows = torch.stack((model.codebook[4], model.special.weight[2]))
    torch.testing.assert_close(model.embed(IDS)[0, :2], model.input_projection(rows))
    before = model(IDS, text(), REAL)
    model.set_codebook(model.codebook.clone().index_fill(0, torch.tensor([4]), 9.0))
    after = model(IDS, text(), REAL)
    assert not torch.equal(before[0], after[0])
    assert torch.equal(before[1], after[1])


def test_hidden_keys_reach_nothing():
    model = make()
    changed = IDS.clone()
    changed[1, 3:] = torch.tensor([5, 6])
    before, after = model(IDS, text(), REAL), model(changed, text(), REAL)
    assert torch.equal(before, after)
    assert not before[1, 4:].any()
    assert not torch.equal(model(changed, text(), ALL)[1, :4], after[1, :4])


def test_a_mask_over_pairs():
    """Let row i see columns up to i: what stands later reaches nothing before it."""
    model = make()
    pairs = torch.ones(2, 6, 6, dtype=torch.bool).tril()
    changed = IDS.clone()
    changed[:, 3] = 7
    before, after = (model(ids, text(), ALL, mask=pairs) for ids in (IDS, changed))
    assert torch.equal(before[:, :4], after[:, :4])
    assert not torch.equal(before[:, 4:], after[:, 4:])
    keys = torch.nn.functional.pad(REAL, (1, 0), value=True)[:, None].expand(-1, 6, -1)
    torch.testing.assert_close(model(IDS, text(), REAL, mask=keys), model(IDS, text(), REAL))


def test_padded_words_are_not_read_and_refused_where_all_are():
    model, changed = make(), text()
    changed.tokens[1, 4:] = 50.0
    assert torch.equal(*(model(IDS, t, REAL)[1] for t in (text(), changed)))
    with pytest.raises(ValueError, match="words='all' reads all positions"):
        make(words="all")(IDS, changed, REAL)
    full, changed = (
        TextFeatures(t.texts, t.pooled, t.tokens, torch.ones_like(t.token_mask)) for t in (text(), changed)
    )
    assert not torch.equal(*(make(words="all")(IDS, t, REAL)[1] for t in (full, changed)))
    wide, narrow = make()(IDS, text(), REAL), make()(IDS[1:], TextFeatures([""], *cut(text())), REAL[1:])
    torch.testing.assert_close(narrow[0], wide[1], rtol=1e-4, atol=1e-5)


def cut(features: TextFeatures) -> tuple[torch.Tensor, ...]:
    """Take the second sample, its padding cut off."""
    return features.pooled[1:], features.tokens[1:, :4], features.token_mask[1:, :4]


def test_extra_conditions_stand_behind_the_sentence():
    """Let only the extra tokens see themselves: new ones change the rows 1 and 2 alone."""
    model, extra = make(), torch.randn(2, 2, WIDTH)
    pairs = torch.ones(2, 8, 8, dtype=torch.bool)
    pairs[:, [0, 3, 4, 5, 6, 7], 1:3] = False
    before, after = (model(IDS, text(), ALL, tokens, pairs) for tokens in (extra, extra.flip(0)))
    assert before.shape == (2, 8, CODES)
    assert (before != after).any(dim=-1).tolist() == [[False, True, True, *[False] * 5]] * 2


def test_end_and_padding_are_written_behind_the_ids():
    ids, visible = with_end(torch.tensor([[4, 5, 6], [7, 0, 0]]), torch.tensor([3, 1]), CODES)
    assert ids.tolist() == [[4, 5, 6, 11], [7, 11, 12, 12]]
    assert visible.tolist() == [[True] * 4, [True, True, False, False]]


@pytest.mark.parametrize("conditions", [1, 2])
def test_losses_average_samples_not_tokens(conditions):
    logits = torch.randn(2, conditions + 4, CODES, generator=torch.Generator().manual_seed(0))
    codes, real = torch.tensor([[4, 5, 6], [7, 0, 0]]), torch.tensor([[1, 1, 1], [1, 0, 0]], dtype=torch.bool)
    logits[:, conditions + 1, 5] += 20.0
    own = logits[:, conditions:]
    rows = [torch.nn.functional.cross_entropy(own[i, :n], codes[i, :n]) for i, n in enumerate((3, 1))]
    losses = code_losses(logits, codes, real, conditions)
    torch.testing.assert_close(losses["loss"], torch.stack(rows).mean())
    hits = own[:, :3].argmax(-1) == codes
    assert losses["accuracy"].item() == pytest.approx((hits[0].float().mean() + hits[1, 0].float()).item() / 2)
    assert losses["accuracy"] > 0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: make(words="some"), "TokenTransformer.words=some: must be one of real, all"),
        (lambda: make().set_codebook(torch.zeros(CODES, DIM + 1)), r"codebook is \(11, 4\).*\(11, 3\)"),
        (lambda: make()(IDS, TextFeatures(["", ""], torch.zeros(2, TEXT)), REAL), "reads_tokens"),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_published_size_has_the_published_number_of_parameters():
    """Count 236.3 M (STATE_DICTS: without the unused table of positions and the tokenizer)."""
    with torch.device("meta"):
        model = TokenTransformer(codebook_size=8192, code_dim=32, specials=3, text_dim=512, token_dim=512)
    count = sum(p.numel() for p in model.parameters()) + 51 * 1024
    assert count / 1e6 == pytest.approx(236.3, abs=0.05)


def test_initialisation():
    """Compare with COMMON §5: N(0, 0.02) weights, zero biases."""
    torch.manual_seed(0)
    model = TokenTransformer(
        codebook_size=64, code_dim=32, specials=50, text_dim=64, token_dim=64, width=64, heads=2, feedforward=64
    )
    for layer in (model.special, model.head, model.text_projection, model.cross_blocks[0].attention.proj):
        assert layer.weight.std().item() == pytest.approx(0.02, rel=0.1)
    assert not model.input_projection.bias.any()
    assert not model.codebook.any()

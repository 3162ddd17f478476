"""Test the shared post-norm encoder: what has a position, what is masked, and decoding with a cache."""

from __future__ import annotations

import pytest
import torch

from kinema.generators.tokens.encoder import EMBEDDING_STD, TokenEncoder
from kinema.nn.attention import KeyValueCache
from kinema.nn.embeddings import sinusoidal_positions


def make(place_prefix: bool = False) -> TokenEncoder:
    torch.manual_seed(0)
    sizes = {"code_dim": 6, "text_dim": 5, "outputs": 7, "width": 16, "feedforward": 24, "layers": 2, "heads": 2}
    encoder = TokenEncoder(**sizes, place_prefix=place_prefix)
    for parameter in encoder.parameters():
        torch.nn.init.normal_(parameter, std=0.25)
    return encoder.eval()


def inputs(seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(2, 9, 6, generator=generator), torch.randn(2, 1, 16, generator=generator)


@pytest.mark.parametrize("place_prefix", [False, True])
def test_positions_count_from_the_first_placed_row(place_prefix):
    encoder, (tokens, prefix) = make(place_prefix), inputs()
    placed = encoder.embed(tokens, prefix) - torch.cat((prefix, encoder.input_projection(tokens)), dim=1)
    expected = sinusoidal_positions(10, 16)
    if not place_prefix:
        expected = torch.cat((torch.zeros(1, 16), expected[:9]))
    torch.testing.assert_close(placed, expected.expand(2, 10, 16))


def test_masked_keys_have_no_influence_and_the_prefix_is_always_seen():
    encoder, (tokens, prefix) = make(), inputs()
    real = torch.arange(9)[None] < torch.tensor([[4], [9]])
    changed = torch.where(real[..., None], tokens, 50.0)
    first, second = (encoder(encoder.embed(x, prefix), real=real) for x in (tokens, changed))
    assert torch.equal(first, second)
    assert not first[0, 5:].any()
    assert not torch.equal(encoder(encoder.embed(tokens, prefix + 1), real=real)[0, 1:5], first[0, 1:5])


def test_a_cache_gives_what_the_whole_sequence_gives():
    encoder, (tokens, prefix) = make(place_prefix=True), inputs()
    causal = torch.ones(1, 10, 10, dtype=torch.bool).tril()
    whole = encoder(encoder.embed(tokens, prefix), causal)
    caches = [KeyValueCache(10) for _ in encoder.blocks]
    rows = [encoder(encoder.embed(tokens[:, :2], prefix), causal[:, :3, :3], caches)]
    rows += [encoder(encoder.embed(tokens[:, i : i + 1], start=i + 1), None, caches) for i in range(2, 9)]
    torch.testing.assert_close(torch.cat(rows, dim=1), whole, rtol=1e-4, atol=1e-5)


def test_dropout_reaches_the_prefix_only_where_it_has_positions():
    tokens, prefix = inputs()
    for place_prefix in (False, True):
        encoder = make(place_prefix).train()
        dropped = (encoder.embed(tokens, prefix)[:, 0] == 0).any()
        assert dropped == place_prefix


def test_tokens_start_as_large_as_positions():
    torch.manual_seed(0)
    encoder = TokenEncoder(code_dim=128, text_dim=5, outputs=7, width=192, layers=1)
    tokens = torch.randn(50, 49, 128) * EMBEDDING_STD
    assert encoder.input_projection(tokens).std().item() == pytest.approx(1, rel=0.05)
    assert not any(part.bias.any() for part in encoder.modules() if isinstance(part, torch.nn.Linear))

from __future__ import annotations

import json
import shutil

import pytest
import torch

from kinema.text.cache import CachedTextEncoder
from kinema.text.encoders import build_text_encoder
from kinema.text.tokens import clip_tokens

TEXTS = ["a man walks", "wave"]


@pytest.mark.parametrize("name", ["clip_b32", "clip_l14"])
def test_pooled_is_the_projected_end_feature_and_tokens_are_before_the_projection(tiny_clip, name):
    from transformers import CLIPModel

    encoder = build_text_encoder(name, tiny_clip)
    found = encoder(TEXTS)
    ids = encoder.tokenizer(TEXTS, padding="max_length", max_length=77, return_tensors="pt")["input_ids"]
    model = CLIPModel.from_pretrained(tiny_clip).eval()
    with torch.no_grad():
        hidden = model.text_model(ids).last_hidden_state  # all 77 positions, causal, no padding mask: as CLIP itself
    ends = ids.argmax(1)
    expected = hidden[torch.arange(2), ends] @ model.text_projection.weight.T
    torch.testing.assert_close(found.pooled, expected, rtol=1e-4, atol=1e-5)
    assert found.token_mask.sum(1).tolist() == (ends + 1).tolist()
    assert found.tokens.shape == (2, int(ends.max()) + 1, 32)
    for row, mask, want in zip(found.tokens, found.token_mask, hidden, strict=True):
        torch.testing.assert_close(row[mask], want[: int(mask.sum())], rtol=1e-4, atol=1e-5)
        assert not row[~mask].any()
    assert (encoder.dim, encoder.token_dim) == (24, 32)
    assert not found.pooled.requires_grad


def test_all_positions_are_those_of_the_published_padding(tiny_clip):
    from transformers import CLIPModel

    encoder = build_text_encoder("clip_b32_77", tiny_clip)
    found, short = encoder(TEXTS), build_text_encoder("clip_b32", tiny_clip)(TEXTS)
    ids = clip_tokens("auto", tiny_clip)(TEXTS)  # 77 ids, zeros behind the end: what the published tokenizer gives
    model = CLIPModel.from_pretrained(tiny_clip).eval().text_model
    with torch.no_grad():
        expected = model(ids).last_hidden_state
        behind = torch.arange(77) > ids.argmax(1)[:, None]
        padded_otherwise = model(ids.masked_fill(behind, int(ids.max()))).last_hidden_state
    torch.testing.assert_close(found.tokens, expected, rtol=1e-4, atol=1e-5)
    assert (found.tokens - padded_otherwise)[:, -1].abs().max() > 0.1
    assert found.token_mask.shape == (2, 77)
    assert found.token_mask.all()
    torch.testing.assert_close(found.pooled, short.pooled, rtol=1e-4, atol=1e-5)
    alone = encoder(TEXTS[1:])
    torch.testing.assert_close(alone.tokens[0], found.tokens[1], rtol=1e-4, atol=1e-5)


def test_all_positions_have_a_cache_of_their_own(tiny_clip, tmp_path):
    plain, whole = (build_text_encoder(name, tiny_clip) for name in ("clip_b32", "clip_b32_77"))
    assert whole.identity.startswith("clip_b32_77-")
    assert whole.identity.removeprefix("clip_b32_77") == plain.identity.removeprefix("clip_b32")
    caches = [CachedTextEncoder(encoder, tmp_path) for encoder in (plain, whole)]
    assert [cache(TEXTS).tokens.shape[1] for cache in caches] == [plain(TEXTS).tokens.shape[1], 77]
    again = CachedTextEncoder(whole, tmp_path)
    torch.testing.assert_close(again(TEXTS).tokens, whole(TEXTS).tokens)
    assert again.encoded == 0


@pytest.mark.parametrize("name", ["clip_b32", "clip_b32_77"])
def test_long_text_is_truncated_to_the_context_and_keeps_its_end(tiny_clip, name):
    encoder = build_text_encoder(name, tiny_clip)
    found = encoder(["walk " * 100])
    assert found.token_mask.sum() == 77
    assert torch.isfinite(found.pooled).all()


def test_identity_follows_the_weights_and_needs_no_model(tiny_clip, tmp_path):
    first = build_text_encoder("clip_b32", tiny_clip)
    assert first.identity.startswith("clip_b32-")
    assert "model" not in vars(first)
    other = shutil.copytree(tiny_clip, tmp_path / "other")
    assert build_text_encoder("clip_b32", other).identity == first.identity
    raw = bytearray((other / "model.safetensors").read_bytes())
    raw[-1] ^= 1
    (other / "model.safetensors").write_bytes(raw)
    assert build_text_encoder("clip_b32", other).identity != first.identity


def test_missing_tokenizer_files_are_an_error_not_a_vocabulary_of_two(tiny_clip, tmp_path):
    folder = shutil.copytree(tiny_clip, tmp_path / "bare", ignore=shutil.ignore_patterns("vocab.json", "merges.txt"))
    with pytest.raises(FileNotFoundError, match=r"tokenizer.*55.*text=minilm"):
        build_text_encoder("clip_b32", folder)(TEXTS)


def test_tokenizer_of_another_model_is_refused(tiny_clip, tmp_path):
    folder = shutil.copytree(tiny_clip, tmp_path / "mixed")
    vocabulary = json.loads((folder / "vocab.json").read_text())
    (folder / "vocab.json").write_text(json.dumps(vocabulary | {"zz": len(vocabulary)}))
    with pytest.raises(FileNotFoundError, match="has 56 entries, its model 55"):
        build_text_encoder("clip_b32", folder)(TEXTS)


@pytest.mark.parametrize("path", [None, "/no/such/folder", "./no/such"])
def test_absent_files_name_the_place_and_the_way_without(path, monkeypatch):
    huggingface_hub = pytest.importorskip("huggingface_hub")

    def offline(*_args, **_kwargs):
        raise ConnectionError("offline")

    monkeypatch.setattr(huggingface_hub, "snapshot_download", offline)
    with pytest.raises(FileNotFoundError, match=r"model\.safetensors.*text\.path=FOLDER.*text=minilm"):
        build_text_encoder("clip_b32", path)


def test_hub_snapshot_in_the_cache_is_used(tiny_clip, monkeypatch):
    import huggingface_hub

    asked = []

    def cached(repository, *, allow_patterns, local_files_only):
        asked.append((repository, local_files_only))
        return str(tiny_clip)

    monkeypatch.setattr(huggingface_hub, "snapshot_download", cached)
    assert build_text_encoder("clip_l14").folder == tiny_clip
    assert asked == [("openai/clip-vit-large-patch14", True)]


def test_token_table_of_clip_files(tiny_clip):
    from transformers import CLIPModel

    table = clip_tokens("auto", tiny_clip)
    model = CLIPModel.from_pretrained(tiny_clip).text_model.embeddings
    torch.testing.assert_close(table.embedding, model.token_embedding.weight.detach())
    torch.testing.assert_close(table.positional, model.position_embedding.weight.detach())
    ids = table([*TEXTS, "walk " * 100])
    assert ids.shape == (3, 77)
    assert table.end_positions(ids).tolist() == ids.argmax(1).tolist()
    assert ids[2, 76] == table.end
    assert ids[1, int(table.end_positions(ids)[1]) + 1 :].sum() == 0  # CLIP pads with 0, which the evaluator sees

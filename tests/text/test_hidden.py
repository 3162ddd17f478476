"""Words are the last hidden states, start and end included; files are this machine's, and what is missing is named."""

from __future__ import annotations

import json
import shutil
import string
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from kinema.text.encoders import build_text_encoder
from kinema.text.hidden import PRETRAINED

TEXTS = ["a man walks", "wave", "someone jumps and then sits down"]
KINDS = ("distilbert", "t5_small")


def distilbert(folder: Path) -> None:
    import transformers

    letters = string.ascii_lowercase
    words = ["[PAD]", "[UNK]", "[CLS]", "[SEP]", "[MASK]", *letters, *(f"##{c}" for c in letters)]
    config = {"vocab_size": len(words), "dim": 24, "hidden_dim": 32, "n_layers": 2, "n_heads": 2}
    transformers.DistilBertModel(transformers.DistilBertConfig(**config)).save_pretrained(folder)
    transformers.BertTokenizer(vocab={word: i for i, word in enumerate(words)}).save_pretrained(folder)


def t5(folder: Path) -> None:
    import transformers

    pieces = ["<pad>", "</s>", "<unk>", "\u2581", *string.ascii_lowercase]
    config = {"vocab_size": 40, "d_model": 24, "d_kv": 8, "d_ff": 32, "num_layers": 2, "num_heads": 3}
    # As the published files: encoder and decoder, of which the first is read.
    transformers.T5ForConditionalGeneration(transformers.T5Config(**config)).save_pretrained(folder)
    tokenizer = transformers.T5Tokenizer(vocab=[(piece, -1.0) for piece in pieces], extra_ids=0)
    tokenizer.save_pretrained(folder)


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Callable[[str], Path]:
    """Make a tiny model of a kind, once: random weights and a vocabulary of letters."""
    pytest.importorskip("transformers")
    found: dict[str, Path] = {}

    def make(name: str) -> Path:
        if name not in found:
            torch.manual_seed(0)
            found[name] = tmp_path_factory.mktemp(name)
            (distilbert if name == "distilbert" else t5)(found[name])
        return found[name]

    return make


def published(name: str, folder: Path):
    """Load what transformers itself makes of the folder."""
    import transformers

    model = {"distilbert": transformers.DistilBertModel, "t5_small": transformers.T5EncoderModel}[name]
    return model.from_pretrained(folder).eval(), transformers.AutoTokenizer.from_pretrained(folder)


@pytest.mark.parametrize("name", KINDS)
def test_words_are_the_last_hidden_states_and_pooled_is_their_mean(made, name):
    folder = made(name)
    encoder = build_text_encoder(name, folder)
    found = encoder(TEXTS)
    model, tokenizer = published(name, folder)
    assert (encoder.dim, encoder.token_dim) == (24, 24)
    for i, text in enumerate(TEXTS):
        ids = tokenizer(text, return_tensors="pt")["input_ids"]
        with torch.no_grad():
            hidden = model(input_ids=ids).last_hidden_state[0]
        ends = tokenizer.convert_ids_to_tokens(ids[0])[:: len(ids[0]) - 1]
        assert ends == ["[CLS]", "[SEP]"] if name == "distilbert" else ends[1] == "</s>"
        torch.testing.assert_close(found.tokens[i][found.token_mask[i]], hidden, rtol=1e-4, atol=1e-5)
        torch.testing.assert_close(found.pooled[i], hidden.mean(0), rtol=1e-4, atol=1e-5)
    assert not found.tokens[~found.token_mask].any()
    assert not found.pooled.requires_grad
    assert encoder.empty().token_mask.sum() == (2 if name == "distilbert" else 1)


@pytest.mark.parametrize("name", KINDS)
def test_a_text_does_not_depend_on_its_batch(made, name):
    encoder = build_text_encoder(name, made(name))
    together = encoder(TEXTS * 50)
    for i, text in enumerate(TEXTS):
        alone = encoder([text])
        torch.testing.assert_close(alone.pooled[0], together.pooled[i], atol=1e-5, rtol=0)
        torch.testing.assert_close(alone.tokens[0], together.tokens[i][together.token_mask[i]], atol=1e-5, rtol=0)


def test_a_text_longer_than_the_context_is_cut_and_told(made):
    with pytest.warns(UserWarning, match="T5 reads 64 tokens and cuts 1 of 1"):
        assert build_text_encoder("t5_small", made("t5_small"))(["walk " * 100]).token_mask.sum() == 64


@pytest.mark.parametrize("name", KINDS)
def test_identity_follows_the_weights_and_needs_no_model(made, name, tmp_path):
    first = build_text_encoder(name, made(name))
    assert first.identity.startswith(f"{name}-")
    assert "model" not in vars(first)
    other = shutil.copytree(made(name), tmp_path / "other")
    assert build_text_encoder(name, other).identity == first.identity
    raw = bytearray((other / "model.safetensors").read_bytes())
    raw[-1] ^= 1
    (other / "model.safetensors").write_bytes(raw)
    assert build_text_encoder(name, other).identity != first.identity


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("file", ["config.json", "model.safetensors", "tokenizer.json"])
def test_a_missing_file_is_named_with_its_place(made, name, file, tmp_path):
    folder = shutil.copytree(made(name), tmp_path / "bare")
    (folder / file).unlink()
    where = rf"at '.*bare' \({file} missing\).*text\.path=FOLDER or set {name.upper()}=FOLDER"
    with pytest.raises(FileNotFoundError, match=where):
        build_text_encoder(name, folder)


@pytest.mark.parametrize("name", PRETRAINED)
def test_nothing_is_ever_downloaded(name, monkeypatch):
    hub = pytest.importorskip("huggingface_hub")
    asked = []

    def snapshot(repository, *, allow_patterns, local_files_only):
        asked.append((repository, local_files_only))
        raise FileNotFoundError("not cached")

    monkeypatch.setattr(hub, "snapshot_download", snapshot)
    with pytest.raises(FileNotFoundError, match=rf"no such folder.*Nothing is downloaded: .*{name.upper()}=FOLDER"):
        build_text_encoder(name)
    assert asked == [(PRETRAINED[name].repository, True)]


def test_another_model_and_another_tokenizer_are_refused(made, tmp_path):
    with pytest.raises(ValueError, match="holds a model of the type 't5', text=distilbert reads 'distilbert'"):
        build_text_encoder("distilbert", made("t5_small"))
    folder = shutil.copytree(made("distilbert"), tmp_path / "mixed")
    sizes = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps(sizes | {"vocab_size": 9}))
    with pytest.raises(ValueError, match="has 57 entries, its model 9"):
        build_text_encoder("distilbert", folder)(TEXTS)

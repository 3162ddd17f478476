"""Test causal generation: training loss, causality, END, given lengths, known codes, the cache and errors."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from kinema.decoding.draws import SeededDraws
from kinema.generators.gpt.model import T2MGPT
from kinema.generators.gpt.sampling import GptSampling
from kinema.generators.gpt.training import GptDraws, corrupt
from kinema.generators.lengths import requested_lengths
from kinema.generators.tokens.targets import targets
from kinema.nn import ranks
from kinema.types import Known, Latents, TextFeatures, frame_mask

CODES = 10
FRAMES = torch.tensor([48, 20, 36])
SEEDS = torch.tensor([11, 12, 13])
CROSS = pytest.mark.parametrize("cross_layers", [0, 2], ids=["t2m_gpt", "attt2m"])


def make(cross_layers: int = 0, **options) -> T2MGPT:
    """Make a tiny model with weights large enough that everything has an influence."""
    torch.manual_seed(0)
    sizes = {"width": 16, "feedforward": 24, "layers": 2, "heads": 2, "dropout": 0.3, "max_latents": 12}
    model = T2MGPT(codebook_size=CODES, text_dim=5, token_dim=6, cross_layers=cross_layers, **(sizes | options))
    for parameter in model.parameters():
        torch.nn.init.normal_(parameter, std=0.25)
    return model.eval()


def text(rows: list[int] | None = None, padding: int = 0) -> TextFeatures:
    """Give some of four texts of 7, 3, 5 and 4 words; `padding` more word positions hold garbage."""
    generator = torch.Generator().manual_seed(1)
    pooled, words = torch.randn(4, 5, generator=generator), torch.randn(4, 7, 6, generator=generator)
    words = torch.cat((words, torch.full((4, padding, 6), 50.0)), dim=1)
    real = frame_mask(torch.tensor([7, 3, 5, 4]), 7 + padding)
    rows = [0, 1, 2] if rows is None else rows
    return TextFeatures([str(i) for i in rows], pooled[rows], words[rows], real[rows])


def latents(frames: torch.Tensor = FRAMES) -> Latents:
    lengths = frames // 4
    codes = torch.randint(CODES, (4, 12, 1), generator=torch.Generator().manual_seed(2))
    return Latents(lengths=lengths, frames=frames, codes=codes[: len(frames), : int(lengths.max())])


def draw(pkeep: float, seed: int = 0, samples: int = 3) -> GptDraws:
    generator = torch.Generator().manual_seed(seed)
    return GptDraws.draw(
        (samples, 12), codebook_size=CODES, pkeep=pkeep, generator=generator, device=torch.device("cpu")
    )


def close(a: torch.Tensor, b: torch.Tensor) -> None:
    torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-5)


# The network


@CROSS
def test_a_token_changes_nothing_before_it(cross_layers):
    model, ids = make(cross_layers), latents().codes[..., 0]
    base = model(ids, text())
    for j in (0, 4, 11):
        changed = ids.clone()
        changed[:, j] = (changed[:, j] + 1) % CODES
        logits = model(changed, text())
        assert torch.equal(logits[:, : j + 1], base[:, : j + 1])
        assert (logits[:, j + 1] - base[:, j + 1]).abs().amax(-1).min() > 1e-4


@pytest.mark.parametrize("cache", [True, False])
def test_a_token_sees_the_words_up_to_its_own_index(cache):
    """Change word w: position w + 1, whose input is token w, is the first that notices."""
    model, ids = make(2), latents().codes[:1, :, 0]
    for w in (0, 3, 6):
        changed = text([0])
        changed.tokens[:, w] += 1
        if cache:
            rows = [
                torch.stack([predict(step, ids) for step in range(12)], dim=1)
                for predict in (model._predictor(t, 12, True) for t in (text([0]), changed))
            ]
        else:
            rows = [model(ids, t) for t in (text([0]), changed)]
        assert torch.equal(rows[0][:, : w + 1], rows[1][:, : w + 1])
        assert (rows[0] - rows[1])[:, w + 1].abs().max() > 1e-4


def test_padded_words_are_hidden_and_refused_where_all_are_read():
    ids = latents().codes[..., 0]
    model = make(2)
    torch.testing.assert_close(model(ids, text()), model(ids, text(padding=4)), rtol=1e-4, atol=1e-5)
    with pytest.raises(ValueError, match="words='all' reads all positions"):
        make(2, words="all")(ids, text(padding=4))


# Training


@CROSS
def test_every_parameter_learns(cross_layers):
    model = make(cross_layers).train()
    model.loss(latents(), text(), generator=torch.Generator().manual_seed(0))["loss"].backward()
    assert [name for name, p in model.named_parameters() if p.grad is None or not p.grad.any()] == []


def test_targets_are_the_codes_then_end_then_padding():
    codes = torch.tensor([[4, 5, 6], [7, 0, 0]])
    assert targets(codes, torch.tensor([3, 1]), 10, 11).tolist() == [[4, 5, 6, 10], [7, 10, 11, 11]]


def test_loss_is_the_mean_per_sample_over_codes_and_end():
    model, batch = make(), latents()
    expected, hits = [], []
    for i, length in enumerate(batch.lengths.tolist()):
        codes = batch.codes[i : i + 1, :length, 0]
        likelihood = model(codes, text([i])).log_softmax(-1)[0]
        wanted = torch.cat((codes[0], torch.tensor([CODES])))
        expected.append(-likelihood.gather(1, wanted[:, None]).mean())
        hits.append((likelihood.argmax(-1) == wanted).float().mean())
    losses = model.loss(batch, text())
    assert next(iter(losses)) == "loss"
    close(losses["loss"], torch.stack(expected).mean())
    close(losses["accuracy"], torch.stack(hits).mean())


@CROSS
def test_padding_never_reaches_the_loss(cross_layers):
    """Give other codes in the padding, and more padding."""
    model = make(cross_layers, dropout=0.0).train()
    clean = latents(torch.tensor([20, 20, 36]))
    garbage = replace(clean, codes=torch.where(clean.mask[..., None], clean.codes, 99))
    wider = replace(clean, codes=torch.cat((garbage.codes, torch.full((3, 3, 1), 99)), dim=1))
    losses = [
        model.loss(x, text(padding=pad), generator=torch.Generator().manual_seed(0))["loss"]
        for x, pad in ((clean, 0), (garbage, 0), (wider, 3))
    ]
    assert torch.equal(losses[0], losses[1])
    close(losses[0], losses[2])


def test_inputs_are_corrupted_in_training_only():
    model, batch = make(dropout=0.0), latents()

    def losses() -> list[torch.Tensor]:
        return [model.loss(batch, text(), generator=torch.Generator().manual_seed(seed))["loss"] for seed in (3, 3, 4)]

    clean = losses()
    assert torch.equal(clean[0], clean[2])
    model.train()
    first, again, other = losses()
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
    assert not torch.equal(first, clean[0])


def test_every_input_position_is_kept_with_probability_pkeep():
    ids = torch.full((400, 12), 77)
    out = corrupt(ids, draw(0.3, samples=400))
    assert (out == 77).float().mean().item() == pytest.approx(0.3, abs=0.02)
    replaced = torch.bincount(out[out != 77], minlength=CODES)
    assert len(replaced) == CODES
    assert replaced.min() > 0.8 * replaced.float().mean()
    assert torch.equal(corrupt(ids, draw(1.0, samples=400)), ids)
    assert not (corrupt(ids, draw(0.0, samples=400)) == 77).any()


def test_pkeep_minus_one_draws_one_rate_per_batch():
    rates = torch.stack([draw(-1, seed, samples=60).keep.float().mean(dim=1) for seed in range(40)])
    assert rates.mean(dim=1).std() > 0.2
    assert (rates - rates.mean(dim=1, keepdim=True)).abs().mean() < 0.15
    assert make(pkeep=-1).train().loss(latents(), text())["loss"].isfinite()


def test_ranks_average_to_the_loss_of_one_process(monkeypatch):
    model, batch = make(dropout=0.0).train(), latents(torch.tensor([48, 20, 36, 8]))

    def loss(rows: list[int], shard: tuple[int, int]) -> torch.Tensor:
        part = Latents(batch.lengths[rows], batch.frames[rows], codes=batch.codes[rows])
        return model.loss(part, text(rows), generator=torch.Generator().manual_seed(5), shard=shard)["loss"]

    whole = loss([0, 1, 2, 3], (0, 1))
    monkeypatch.setattr(ranks.distributed, "is_initialized", lambda: True)
    monkeypatch.setattr(ranks.distributed, "all_reduce", lambda rows: rows.mul_(2))
    shards = torch.stack([loss([2 * rank, 2 * rank + 1], (rank, 2)) for rank in (0, 1)])
    assert not torch.allclose(shards[0], shards[1])
    close(shards.mean(), whole)


# Generation


@CROSS
@pytest.mark.parametrize("frames", [FRAMES, None], ids=["given", "predicted"])
def test_samples_do_not_depend_on_batch_order_or_padding(cross_layers, frames):
    model = make(cross_layers)
    together = model.sample(text(), frames, seeds=SEEDS)
    for rows in ([1], [2, 1], [2, 0, 1]):
        some = model.sample(text(rows, padding=3), None if frames is None else frames[rows], seeds=SEEDS[rows])
        for i, row in enumerate(rows):
            length = int(together.lengths[row])
            assert some.lengths[i] == length
            assert torch.equal(some.codes[i, :length], together.codes[row, :length])


@CROSS
@pytest.mark.parametrize("temperature", [0.0, 1.0])
@pytest.mark.parametrize("frames", [FRAMES, None], ids=["given", "predicted"])
def test_the_cache_changes_no_token(cross_layers, temperature, frames):
    """Use more slots than the text has words, and texts of different lengths."""
    model, rows = make(cross_layers), [0, 1, 2] * 8
    frames = None if frames is None else frames.repeat(8)
    results = [
        model.sample(text(rows), frames, seeds=torch.arange(24), sampling=GptSampling(temperature, cache=cache))
        for cache in (True, False)
    ]
    assert torch.equal(results[0].lengths, results[1].lengths)
    assert torch.equal(results[0].codes, results[1].codes)


def test_seed_text_and_temperature_matter():
    model = make()
    base = model.sample(text(), FRAMES, seeds=SEEDS).codes
    assert torch.equal(base, model.sample(text(), FRAMES, seeds=SEEDS).codes)
    for other in (
        model.sample(text(), FRAMES, seeds=SEEDS + 10),
        model.sample(text([2, 0, 1]), FRAMES, seeds=SEEDS),
        model.sample(text(), FRAMES, seeds=SEEDS, sampling=GptSampling(temperature=3.0)),
    ):
        assert not torch.equal(base, other.codes)


def test_greedy_takes_the_likeliest_token_whatever_the_seed():
    model, greedy = make(2), GptSampling(temperature=0)
    result = model.sample(text(), FRAMES, seeds=SEEDS, sampling=greedy)
    assert torch.equal(result.codes, model.sample(text(), FRAMES, seeds=SEEDS + 5, sampling=greedy).codes)
    logits = model(result.codes[:, :-1, 0], text())[..., :CODES]
    assert torch.equal(logits.argmax(-1)[result.mask], result.codes[..., 0][result.mask])


def test_given_frames_are_met_exactly_even_where_end_is_likeliest():
    model = make()
    end_first(model)
    result = model.sample(text(), torch.tensor([49, 20, 7]), seeds=SEEDS)
    assert result.lengths.tolist() == [12, 5, 1]
    assert result.frames.tolist() == [48, 20, 4]
    assert not result.codes[~result.mask].any()
    assert (result.codes < CODES).all()


def end_first(model: T2MGPT) -> None:
    """Make END by far the likeliest class at every position."""
    torch.nn.init.zeros_(model.norm.weight)
    torch.nn.init.ones_(model.norm.bias)
    torch.nn.init.ones_(model.head.weight[CODES])


def test_a_motion_that_ends_at_once_is_one_token_of_code_one():
    model = make()
    end_first(model)
    result = model.sample(text(), None, seeds=SEEDS, sampling=GptSampling(temperature=0))
    assert result.codes.tolist() == [[[1]], [[1]], [[1]]]
    assert (result.lengths.tolist(), result.frames.tolist()) == ([1, 1, 1], [4, 4, 4])


def test_predicted_lengths_follow_end():
    """Compare with the probabilities that the model gives to END after each prefix."""
    model, count = make(), 4000
    rows = [0] * count
    result = model.sample(text(rows), None, seeds=torch.arange(count))
    assert result.codes.shape[1] == result.lengths.max() <= 12
    assert not result.codes[~result.mask].any()
    assert (result.codes < CODES).all()
    first = model(torch.zeros(1, 0, dtype=torch.long), text([0])).softmax(-1)[0, 0]
    second = model(torch.arange(CODES)[:, None], text([0] * CODES)).softmax(-1)[:, 1, CODES]
    one = first[CODES] + (first[:CODES] * second).sum()
    assert (result.lengths == 1).float().mean().item() == pytest.approx(one.item(), abs=0.03)
    assert result.lengths.unique().numel() > 8


def test_a_model_that_never_ends_fills_max_latents():
    model = make()
    torch.nn.init.zeros_(model.norm.weight)
    torch.nn.init.ones_(model.norm.bias)
    torch.nn.init.constant_(model.head.weight[CODES], -9)
    assert model.predicts_length
    assert model.sample(text(), None, seeds=SEEDS).lengths.tolist() == [12, 12, 12]


def test_training_mode_is_left_alone_and_has_no_dropout_in_samples():
    model = make()
    expected = model.sample(text(), FRAMES, seeds=SEEDS).codes
    model.train()
    assert torch.equal(model.sample(text(), FRAMES, seeds=SEEDS).codes, expected)
    assert model.training
    assert model.blocks[0].training


def test_injected_draws_replace_the_seeds():
    model = make()
    own = model.sample(text(), FRAMES, seeds=SEEDS).codes
    assert torch.equal(model.sample(text(), FRAMES, seeds=SEEDS * 0, draws=SeededDraws(SEEDS)).codes, own)


# Sampling options


def test_top_k_and_top_p_keep_the_likeliest_classes():
    logits = torch.tensor([[0.1, 0.4, 0.2, 0.3], [0.05, 0.05, 0.1, 0.8]]).log()

    def kept(**options) -> list[list[bool]]:
        return GptSampling(**options).narrow(logits).isfinite().tolist()

    assert kept(top_k=2) == [[False, True, False, True], [False, False, True, True]]
    assert kept(top_p=0.5) == [[False, True, False, True], [False, False, False, True]]
    assert kept(top_p=0.01) == [[False, True, False, False], [False, False, False, True]]
    assert kept(top_k=1, top_p=1.0) == kept(top_p=0.01)
    assert kept(top_k=9, top_p=1.0) == [[True] * 4] * 2
    # Of the two that top_k leaves, the likelier one holds 4/7 and 8/9.
    assert kept(top_k=2, top_p=0.6) == [[False, True, False, True], [False, False, False, True]]
    torch.testing.assert_close(GptSampling(temperature=0.5).narrow(logits), 2 * logits)


def test_top_k_one_is_greedy():
    model = make()
    results = [
        model.sample(text(), FRAMES, seeds=SEEDS, sampling=GptSampling(temperature=t, top_k=k)).codes
        for t, k in ((0, None), (1.0, 1))
    ]
    assert torch.equal(*results)


@pytest.mark.parametrize("options", [{"temperature": -1}, {"top_k": 0}, {"top_p": 0.0}, {"top_p": 1.5}])
def test_sampling_options_out_of_range(options):
    ((name, value),) = options.items()
    with pytest.raises(ValueError, match=f"GptSampling.{name}={value}: must be"):
        GptSampling(**options)


# Editing


def known(keep: torch.Tensor) -> Known:
    return Known(latents(), keep)


@CROSS
def test_known_codes_stay_and_the_rest_is_generated(cross_layers):
    keep = torch.rand(3, 12, generator=torch.Generator().manual_seed(3)) < 0.5
    keep[1], keep[2] = True, False
    model, source = make(cross_layers), latents()
    result = model.sample(text(), None, seeds=SEEDS, known=known(keep))
    assert torch.equal(result.lengths, source.lengths)
    kept = keep & source.mask
    assert torch.equal(result.codes[kept], source.codes[kept])
    assert not result.codes[~result.mask].any()
    assert (result.codes[0] != source.codes[0]).any()
    free = model.sample(text(), FRAMES, seeds=SEEDS)
    assert torch.equal(result.codes[2], free.codes[2])
    assert torch.equal(result.codes, model.sample(text(), FRAMES, seeds=SEEDS, known=known(keep)).codes)


def test_a_known_code_acts_to_its_right_only():
    model = make()
    keep = torch.zeros(3, 12, dtype=torch.bool)
    keep[:, 6] = True
    free = model.sample(text(), FRAMES, seeds=SEEDS).codes
    results = []
    for code in range(CODES):
        source = latents()
        source.codes[:, 6] = code
        result = model.sample(text(), None, seeds=SEEDS, known=Known(source, keep)).codes
        assert torch.equal(result[:, :6], free[:, :6])
        results.append(result[0, 7:, 0])
    assert torch.stack(results).unique(dim=0).shape[0] > 1


# Errors


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"words": "some"}, "T2MGPT.words=some: must be one of real, all"),
        ({"pkeep": 1.5}, "T2MGPT.pkeep=1.5: must be a finite number >= 0 and <= 1 or -1"),
        ({"heads": 3}, "width 16 is not a multiple of heads 3"),
        ({"cross_layers": 2, "token_dim": None}, "cross_layers=2 need token_dim"),
    ],
)
def test_wrong_options_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        T2MGPT(**{"codebook_size": 9, "text_dim": 5, "width": 16, "heads": 2, "layers": 1} | options)


def test_errors_name_what_does_not_fit():
    model = make(2)
    pooled = replace(text(), tokens=None, token_mask=None)
    for ask in (
        lambda: model.loss(latents(), pooled),
        lambda: model.sample(pooled, FRAMES, seeds=SEEDS),
    ):
        with pytest.raises(ValueError, match="reads_tokens: true"):
            ask()
    with pytest.raises(ValueError, match="cannot generate 52 frames; give 4 to 48 frames"):
        model.sample(text(), torch.tensor([48, 52, 20]), seeds=SEEDS)
    with pytest.raises(ValueError, match="2 seeds; give one of each per sample"):
        requested_lengths(model.space, text(), FRAMES, SEEDS[:2], None, device=torch.device("cpu"))
    with pytest.raises(ValueError, match="token id 10 is out of range"):
        model.loss(replace(latents(), codes=latents().codes.masked_fill(latents().codes == 9, 10)), text())
    with pytest.raises(ValueError, match="known latents have lengths"):
        model.sample(text(), FRAMES + 4 * torch.tensor([-1, 0, 0]), seeds=SEEDS, known=known(latents().mask))

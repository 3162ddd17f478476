"""Test MMM: corruption, loss, generation, edits, invariances and errors."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from kinema.decoding.draws import Greedy, SeededDraws
from kinema.generators import mmm
from kinema.generators.mmm import MMM, MmmDraws, MmmSampling
from kinema.types import Known, Latents, TextFeatures

CODES = 17
FRAMES = torch.tensor([48, 20, 36])
SEEDS = torch.tensor([11, 12, 13])
GREEDY = MmmSampling(temperature=0.0)


def make(**options) -> MMM:
    """Make a tiny model in which everything has an influence."""
    torch.manual_seed(0)
    sizes = {"width": 16, "heads": 2, "feedforward": 24, "cross_layers": 1, "base_layers": 1, "head_layers": 1}
    options = sizes | {"dropout": 0.3, "max_latents": 12} | options
    model = MMM(codebook_size=CODES, code_dim=4, text_dim=5, token_dim=6, **options)
    for parameter in model.parameters():
        torch.nn.init.normal_(parameter, std=0.4)
    model.set_codebook(torch.randn(CODES, 4))
    return model.eval()


def text(rows: list[int] | None = None) -> TextFeatures:
    generator = torch.Generator().manual_seed(1)
    pooled, tokens = torch.randn(4, 5, generator=generator), torch.randn(4, 7, 6, generator=generator)
    rows = [0, 1, 2] if rows is None else rows
    real = torch.arange(7) < torch.tensor([7, 3, 5, 4])[rows, None]
    longest = int(real.sum(dim=1).max())
    return TextFeatures([str(i) for i in rows], pooled[rows], tokens[rows, :longest], real[:, :longest])


def latents(frames: torch.Tensor = FRAMES) -> Latents:
    lengths = frames // 4
    codes = torch.randint(CODES, (4, 12, 1), generator=torch.Generator().manual_seed(2))
    return Latents(lengths=lengths, frames=frames, codes=codes[: len(frames), : int(lengths.max())])


def draws(samples: int = 3, seed: int = 0, pkeep: float = 0.5) -> MmmDraws:
    return MmmDraws.draw(
        (samples, 12),
        CODES,
        pkeep=pkeep,
        generator=torch.Generator().manual_seed(seed),
        device=torch.device("cpu"),
    )


def watch(model: MMM) -> list[torch.Tensor]:
    """Record the ids that the transformer reads."""
    seen: list[torch.Tensor] = []
    model.transformer.register_forward_pre_hook(lambda module, inputs: seen.append(inputs[0]))
    return seen


# Training


def test_every_parameter_learns():
    model = make().train()
    losses = model.loss(latents(), text(), generator=torch.Generator().manual_seed(0))
    losses["loss"].backward()
    assert [name for name, p in model.named_parameters() if p.grad is None or not p.grad.any()] == []
    assert next(iter(losses)) == "loss"
    assert 0 <= losses["accuracy"] <= 1


def test_loss_is_a_function_of_the_generator():
    model = make()
    first, again, other = (
        model.loss(latents(), text(), generator=torch.Generator().manual_seed(seed))["loss"] for seed in (3, 3, 4)
    )
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_padding_never_reaches_the_loss():
    """Give garbage in the padding, and more padding."""
    model, clean = make(), latents(torch.tensor([20, 20, 36]))
    garbage = replace(clean, codes=torch.where(clean.mask[..., None], clean.codes, 999))
    wider = replace(clean, codes=torch.cat((garbage.codes, torch.full((3, 3, 1), -1)), dim=1))
    losses = [
        model.loss(x, text(), draws=draws().crop(slice(None), x.codes.shape[1]))["loss"]
        for x in (clean, garbage, wider)
    ]
    assert torch.equal(losses[0], losses[1])
    torch.testing.assert_close(losses[0], losses[2], rtol=1e-4, atol=1e-5)


def test_corruption_shares():
    """Compare with MMM, Training: U(0.5, 1) of the positions masked, half of the others replaced at random."""
    model, samples = make().train(), 300
    seen = watch(model)
    batch = Latents(torch.full((samples,), 12), torch.full((samples,), 48), codes=torch.full((samples, 12, 1), 5))
    many = TextFeatures([""] * samples, torch.zeros(samples, 5), torch.zeros(samples, 2, 6))
    model.loss(batch, many, generator=torch.Generator().manual_seed(0))
    ids = seen[0][:, :12]
    masked = ids == model.mask_id
    assert masked.sum(dim=1).min() == 6
    assert masked.sum(dim=1).max() == 12
    assert masked.float().mean().item() == pytest.approx(0.75, abs=0.02)
    assert masked.float().mean(dim=0).std() < 0.05
    assert (ids[~masked] == 5).float().mean().item() == pytest.approx(0.5 + 0.5 / CODES, abs=0.05)
    assert len(ids[~masked].unique()) == CODES
    seen.clear()
    model.eval().loss(batch, many, generator=torch.Generator().manual_seed(0))
    assert set(seen[0][:, :12].unique().tolist()) == {5, model.mask_id}


def test_one_probability_to_keep_per_batch():
    shares = [draws(200, seed, pkeep=-1).keep.float().mean().item() for seed in range(12)]
    assert max(shares) - min(shares) > 0.4
    rows = draws(200, 0, pkeep=-1).keep.float().mean(dim=1)
    assert rows.std() < 0.2


def test_masked_and_replaced_codes_do_not_leak():
    """Change the codes that the transformer may not see: their logits stay bit-equal."""
    model, batch, drawn = make(), latents(), draws()
    outputs: list[torch.Tensor] = []
    model.transformer.register_forward_hook(lambda module, inputs, output: outputs.append(output))
    seen = watch(model)
    model.loss(batch, text(), draws=drawn)
    hidden = (seen[0][:, :-1] == model.mask_id) | ~drawn.keep
    changed = torch.where(hidden[..., None], (batch.codes + 3) % CODES, batch.codes)
    losses = [model.loss(replace(batch, codes=codes), text(), draws=drawn)["loss"] for codes in (batch.codes, changed)]
    assert torch.equal(outputs[0], outputs[2])
    assert not torch.equal(*losses)


def test_ranks_average_to_the_loss_of_one_process():
    model, batch = make(dropout=0.0).train(), latents(torch.tensor([48, 20, 36, 8]))

    def loss(rows: list[int], shard: tuple[int, int]) -> torch.Tensor:
        part = Latents(batch.lengths[rows], batch.frames[rows], codes=batch.codes[rows])
        return model.loss(part, text(rows), generator=torch.Generator().manual_seed(5), shard=shard)["loss"]

    ranks = torch.stack([loss([2 * rank, 2 * rank + 1], (rank, 2)) for rank in (0, 1)])
    torch.testing.assert_close(ranks.mean(), loss([0, 1, 2, 3], (0, 1)), rtol=1e-4, atol=1e-5)


# Generation


@pytest.mark.parametrize("sampling", [MmmSampling(), GREEDY])
def test_samples_do_not_depend_on_batch_order_or_padding(sampling):
    model = make()
    together = model.sample(text(), FRAMES, seeds=SEEDS, sampling=sampling)
    for rows in ([1], [2, 1], [2, 0, 1]):
        some = model.sample(text(rows), FRAMES[rows], seeds=SEEDS[rows], sampling=sampling)
        for i, row in enumerate(rows):
            length = int(together.lengths[row])
            assert torch.equal(some.codes[i, :length], together.codes[row, :length])


def test_seed_text_and_temperature_matter():
    model = make()
    base = model.sample(text(), FRAMES, seeds=SEEDS).codes
    assert torch.equal(base, model.sample(text(), FRAMES, seeds=SEEDS).codes)
    for other in (
        model.sample(text(), FRAMES, seeds=SEEDS + 10),
        model.sample(text([2, 0, 1]), FRAMES, seeds=SEEDS),
        model.sample(text(), FRAMES, seeds=SEEDS, sampling=MmmSampling(temperature=0.3)),
    ):
        assert not torch.equal(base, other.codes)
    greedy = [model.sample(text(), FRAMES, seeds=seeds, sampling=GREEDY).codes for seeds in (SEEDS, SEEDS + 10)]
    assert torch.equal(*greedy)
    assert torch.equal(greedy[0], model.sample(text(), FRAMES, seeds=SEEDS, draws=Greedy(SEEDS)).codes)


def test_result_counts_whole_latents_and_has_zero_padding():
    result = make().sample(text(), torch.tensor([49, 20, 7]), seeds=SEEDS)
    assert result.lengths.tolist() == [12, 5, 1]
    assert result.frames.tolist() == [48, 20, 4]
    assert result.codes.shape == (3, 12, 1)
    assert not result.codes[~result.mask].any()
    assert result.codes.dtype == torch.long
    assert 0 <= result.codes.min() <= result.codes.max() < CODES


def test_the_transformer_reads_masks_and_the_end():
    """Read what each step sees: all masked at first, fewer and fewer, the last one at the end; END behind the codes."""
    model = make()
    seen = watch(model)
    model.sample(text(), FRAMES, seeds=SEEDS)
    counts = torch.stack([(ids == model.mask_id).sum(dim=1) for ids in seen])
    assert torch.equal(counts, mmm.shrinking_counts(FRAMES // 4, 10))
    for ids in seen:
        assert ids.shape == (3, 13)
        assert torch.equal((ids == CODES).nonzero()[:, 1], FRAMES // 4)
        assert torch.equal((ids == CODES + 1).sum(dim=1), 12 - FRAMES // 4)


def test_training_mode_is_left_alone_and_has_no_dropout_in_samples():
    model = make()
    expected = model.sample(text(), FRAMES, seeds=SEEDS).codes
    model.train()
    assert torch.equal(model.sample(text(), FRAMES, seeds=SEEDS).codes, expected)
    assert model.training
    assert model.transformer.training


def test_injected_draws_replace_the_seeds():
    model = make()
    own = model.sample(text(), FRAMES, seeds=SEEDS)
    assert torch.equal(model.sample(text(), FRAMES, seeds=SEEDS * 0, draws=SeededDraws(SEEDS)).codes, own.codes)


# Editing


def known(keep: torch.Tensor) -> Known:
    return Known(latents(), keep)


def test_edit_keeps_codes_that_are_never_masked():
    keep = torch.rand(3, 12, generator=torch.Generator().manual_seed(3)) < 0.5
    keep[1], keep[2] = True, False
    model, source = make(), latents()
    seen = watch(model)
    result = model.sample(text(), None, seeds=SEEDS, known=known(keep))
    kept = keep & source.mask
    assert torch.equal(result.codes[kept], source.codes[kept])
    assert not torch.equal(result.codes[2], source.codes[2])
    assert torch.equal(result.lengths, source.lengths)
    assert torch.equal(seen[0][:, :-1] == model.mask_id, source.mask & ~keep)
    for ids in seen:
        assert torch.equal(ids[:, :-1][kept], source.codes[..., 0][kept])


def test_edit_with_everything_known_returns_the_source():
    source = latents()
    result = make().sample(text(), FRAMES, seeds=SEEDS, known=known(torch.ones(3, 12, dtype=torch.bool)))
    assert torch.equal(result.codes, source.codes * source.mask[..., None])


def test_free_positions_of_the_source_do_not_leak():
    keep = torch.zeros(3, 12, dtype=torch.bool)
    keep[:, ::2] = True
    model, source = make(), latents()
    changed = replace(source, codes=torch.where(keep[..., None], source.codes, 1))
    results = [model.sample(text(), None, seeds=SEEDS, known=Known(x, keep)).codes for x in (source, changed)]
    assert torch.equal(*results)


def test_nothing_known_is_generation():
    model = make()
    edited = model.sample(text(), FRAMES, seeds=SEEDS, known=known(torch.zeros(3, 12, dtype=torch.bool)))
    assert torch.equal(edited.codes, model.sample(text(), FRAMES, seeds=SEEDS).codes)


# Errors


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda m: m.sample(text(), torch.tensor([3, 20, 20]), seeds=SEEDS), "cannot generate 3 frames; give 4 to 48"),
        (lambda m: m.sample(text(), None, seeds=SEEDS), "LengthEstimator"),
        (lambda m: m.sample(text([0, 1]), FRAMES, seeds=SEEDS), "3 lengths, 2 texts and 3 seeds"),
        (lambda m: m.loss(replace(latents(), codes=latents().codes + CODES), text()), "allows 0 to 16"),
        (lambda m: m.loss(Latents(FRAMES // 4, FRAMES, values=torch.zeros(3, 12, 4)), text()), "continuous values"),
        (lambda m: m.set_codebook(torch.zeros(3, 4)), r"codebook is \(3, 4\)"),
        (lambda m: make(pkeep=1.5), r"MMM.pkeep=1.5: must be .* or -1"),
        (lambda m: MmmSampling(steps=0), "MmmSampling.steps=0: must be a whole number from 1"),
        (lambda m: MmmSampling(temperature=-1.0), "MmmSampling.temperature=-1.0: must be a finite number >= 0"),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call(make())

"""Test masked autoregression: training loss, generation, edits, invariances and errors."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from kinema.decoding.unmasking import SampleDraws
from kinema.diffusion.ddpm import DDPM
from kinema.diffusion.flow import Flow
from kinema.generators.mar.model import MARDM, MarSampling
from kinema.generators.mar.training import MarDraws, corrupt, training_mask
from kinema.generators.texts import without_words
from kinema.nn import ranks
from kinema.types import Known, Latents, TextFeatures, frame_mask

PROCESSES = {"ddpm": lambda: DDPM(steps=8), "flow": Flow, "words": lambda: Flow(prediction="x1", source_scale=2.0)}
WORDS = {"words": {"token_dim": 7, "null_tokens": 2}}
FRAMES = torch.tensor([48, 20, 36])
SEEDS = torch.tensor([11, 12, 13])
SAMPLING = MarSampling(steps=6, guidance=2.5)


def make(process: str = "flow", **options) -> MARDM:
    """Make a tiny model whose zero-initialised layers are filled, so that everything has an influence."""
    torch.manual_seed(0)
    sizes = {"width": 16, "feedforward": 24, "layers": 2, "heads": 2, "mlp_width": 16, "mlp_depth": 2, "dropout": 0.3}
    sizes |= WORDS.get(process, {})
    model = MARDM(
        latent_dim=6, text_dim=5, process=PROCESSES[process](), max_latents=12, sampling=SAMPLING, **(sizes | options)
    )
    for parameter in model.parameters():
        torch.nn.init.normal_(parameter, std=0.25)
    return model.eval()


def text(rows: list[int] | None = None) -> TextFeatures:
    generator = torch.Generator().manual_seed(1)
    pooled, tokens = torch.randn(4, 5, generator=generator), torch.randn(4, 6, 7, generator=generator)
    rows = [0, 1, 2] if rows is None else rows
    counts = torch.tensor([6, 2, 4, 3])[rows]
    seen = frame_mask(counts, int(counts.max()))
    return TextFeatures([str(i) for i in rows], pooled[rows], tokens[rows][:, : seen.shape[1]] * seen[..., None], seen)


def latents(frames: torch.Tensor = FRAMES) -> Latents:
    lengths = frames // 4
    values = torch.randn(4, 12, 6, generator=torch.Generator().manual_seed(2))
    return Latents(lengths=lengths, frames=frames, values=values[: len(frames), : int(lengths.max())])


def draws(model: MARDM, samples: int = 3, seed: int = 0) -> MarDraws:
    return MarDraws.draw(
        (samples, 12, 6),
        model.process,
        repeats=4,
        condition_drop=0.1,
        generator=torch.Generator().manual_seed(seed),
        device=torch.device("cpu"),
    )


def close(a: torch.Tensor, b: torch.Tensor) -> None:
    torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-5)


# Training


@pytest.mark.parametrize("process", PROCESSES)
def test_every_parameter_learns(process):
    model = make(process).train()
    model.loss(latents(), text(), generator=torch.Generator().manual_seed(0))["loss"].backward()
    assert [name for name, p in model.named_parameters() if p.grad is None or not p.grad.any()] == []


def test_loss_is_a_function_of_the_generator():
    model = make()
    first, again, other = (
        model.loss(latents(), text(), generator=torch.Generator().manual_seed(seed))["loss"] for seed in (3, 3, 4)
    )
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


@pytest.mark.parametrize("mask_length", ["padded", "own"])
def test_padding_never_reaches_the_loss(mask_length):
    """Give garbage in the padding, and more padding."""
    model = make(mask_length=mask_length)
    clean = latents(torch.tensor([20, 20, 36]))
    garbage = replace(clean, values=torch.where(clean.mask[..., None], clean.values, 1e6))
    wider = replace(clean, values=torch.cat((garbage.values, torch.full((3, 3, 6), 1e6)), dim=1))
    losses = [
        model.loss(x, text(), draws=draws(model).crop(slice(None), x.values.shape[1]))["loss"]
        for x in (clean, garbage, wider)
    ]
    assert torch.equal(losses[0], losses[1])
    close(losses[0], losses[2])


def test_hidden_latents_do_not_leak_into_the_condition():
    model, batch = make(), latents()
    drawn = replace(draws(model), to_mask=torch.ones(3, 12, dtype=torch.bool))
    mask = training_mask(drawn, batch.mask, torch.tensor([12]))
    changed = torch.where(mask[..., None], torch.randn(3, 12, 6), batch.values)
    seen = [corrupt(values, mask, model.mask_latent, drawn) for values in (batch.values, changed)]
    assert mask.any()
    assert torch.equal(seen[0], seen[1])


def test_corruption_shares():
    """Compare with 10 % noise, 79.2 % mask latent, 10.8 % unchanged (MARDM §4)."""
    model = make()
    drawn = MarDraws.draw(
        (400, 12, 6),
        model.process,
        repeats=1,
        condition_drop=0.1,
        generator=torch.Generator().manual_seed(0),
        device=torch.device("cpu"),
    )
    values, mask_latent = torch.full((400, 12, 6), 50.0), torch.full((6,), -50.0)
    out = corrupt(values, torch.ones(400, 12, dtype=torch.bool), mask_latent, drawn)[..., 0].flatten()
    shares = [(out == 50).float().mean(), (out == -50).float().mean(), (out.abs() < 10).float().mean()]
    assert torch.tensor(shares).tolist() == pytest.approx([0.108, 0.792, 0.1], abs=0.015)
    assert drawn.condition_drop.float().mean().item() == pytest.approx(0.1, abs=0.04)


def test_mask_counts_padded_or_own_length():
    drawn = replace(draws(make()), mask_time=torch.zeros(3))
    real = frame_mask(torch.tensor([12, 5, 1]), 12)
    assert torch.equal(training_mask(drawn, real, torch.tensor([12])), real)
    own = training_mask(replace(drawn, permutation=torch.arange(12).repeat(3, 1)), real, torch.tensor([12, 5, 1]))
    assert own.sum(dim=1).tolist() == [12, 5, 1]


def test_without_autoregression_everything_is_hidden_and_sampled_in_one_step():
    model, batch = make(mask_ratio="all"), latents()
    other = replace(batch, values=batch.values.flip(0))
    seen = [model._corrupted(x.values, batch.mask, batch.lengths, draws(model)) for x in (batch, other)]
    assert all(torch.equal(mask, batch.mask) for mask, _ in seen)
    assert (seen[0][1][batch.mask] == model.mask_latent).all()
    assert torch.equal(seen[0][1][batch.mask], seen[1][1][batch.mask])
    sampling = replace(model.sampling, steps=1)
    states = list(model.trajectory(text(), FRAMES, seeds=torch.arange(3), sampling=sampling))
    assert len(states) == 2
    assert torch.equal(states[1][0].sampled.cpu(), batch.mask)


def test_the_share_of_noise_is_an_option():
    def noised(share: float) -> float:
        drawn = MarDraws.draw(
            (400, 12, 6),
            make().process,
            repeats=1,
            noise_share=share,
            condition_drop=0.1,
            generator=torch.Generator().manual_seed(0),
            device=torch.device("cpu"),
        )
        return drawn.to_noise.float().mean().item()

    assert noised(0.0) == 0
    assert noised(0.5) == pytest.approx(0.5, abs=0.03)
    model = make(noise_share=0.0, mask_share=1.0)
    drawn = model._draw(latents().values, torch.Generator().manual_seed(0), (0, 1))
    assert not drawn.to_noise.any()
    assert drawn.to_mask.all()
    for wrong in ({"noise_share": 1.5}, {"mask_share": -1}, {"mask_ratio": "none"}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            make(**wrong)


def test_ranks_average_to_the_loss_of_one_process(monkeypatch):
    """Let two ranks of different row counts share them as a process group does."""
    model, batch = make(), latents(torch.tensor([48, 20, 36, 8]))

    def loss(rows: list[int], shard: tuple[int, int]) -> torch.Tensor:
        part = Latents(batch.lengths[rows], batch.frames[rows], batch.values[rows])
        return model.loss(part, text(rows), generator=torch.Generator().manual_seed(5), shard=shard)["loss"]

    whole = loss([0, 1, 2, 3], (0, 1))
    counts = []
    monkeypatch.setattr(ranks.distributed, "is_initialized", lambda: True)
    monkeypatch.setattr(ranks.distributed, "all_reduce", lambda rows: counts.append(rows.item()))
    for rank in (0, 1):
        loss([2 * rank, 2 * rank + 1], (rank, 2))
    monkeypatch.setattr(ranks.distributed, "all_reduce", lambda rows: rows.fill_(sum(counts)))
    both = [loss([2 * rank, 2 * rank + 1], (rank, 2)) for rank in (0, 1)]
    assert counts[0] != counts[1]
    close(torch.stack(both).mean(), whole)


def test_condition_is_dropped_in_training_only():
    drop_all, batch = make(condition_drop=1.0, dropout=0.0), latents()
    other = TextFeatures(["", "", ""], torch.randn(3, 5))

    def losses() -> list[torch.Tensor]:
        return [drop_all.loss(batch, t, generator=torch.Generator().manual_seed(0))["loss"] for t in (text(), other)]

    assert not torch.equal(*losses())
    drop_all.train()
    assert torch.equal(*losses())


def test_a_batch_without_masked_positions_has_loss_zero():
    model, batch = make(), latents()
    drawn = replace(draws(model), permutation=torch.full((3, 12), 99))
    loss = model.loss(batch, text(), draws=drawn)["loss"]
    loss.backward()
    assert loss.item() == 0


# Generation


@pytest.mark.parametrize("process", PROCESSES)
def test_samples_do_not_depend_on_batch_order_or_padding(process):
    model = make(process)
    together = model.sample(text(), FRAMES, seeds=SEEDS)
    for rows in ([1], [2, 1], [2, 0, 1]):
        some = model.sample(text(rows), FRAMES[rows], seeds=SEEDS[rows])
        for i, row in enumerate(rows):
            length = int(together.lengths[row])
            close(some.values[i, :length], together.values[row, :length])


def test_seed_text_and_guidance_matter():
    model = make()
    base = model.sample(text(), FRAMES, seeds=SEEDS).values
    assert torch.equal(base, model.sample(text(), FRAMES, seeds=SEEDS).values)
    for other in (
        model.sample(text(), FRAMES, seeds=SEEDS + 10),
        model.sample(text([2, 0, 1]), FRAMES, seeds=SEEDS),
        model.sample(text(), FRAMES, seeds=SEEDS, sampling=replace(SAMPLING, guidance=1.0)),
    ):
        assert not torch.allclose(base, other.values, atol=1e-3)


def test_result_counts_whole_latents_and_has_zero_padding():
    result = make().sample(text(), torch.tensor([49, 20, 7]), seeds=SEEDS)
    assert result.lengths.tolist() == [12, 5, 1]
    assert result.frames.tolist() == [48, 20, 4]
    assert not result.values[~result.mask].any()
    assert result.values[result.mask].isfinite().all()


@pytest.mark.parametrize("process", ["ddpm", "flow"])
def test_each_latent_goes_through_the_mlp_once_per_pass(process):
    """Count rows: 26 latents x 2 guidance halves x evaluations, not the published 11 times that."""
    model, rows = make(process), []
    model.mlp.final.register_forward_hook(lambda module, inputs, output: rows.append(len(output)))
    evaluations = 8 if process == "ddpm" else 2 * 25
    model.sample(text(), FRAMES, seeds=SEEDS)
    assert sum(rows) == 26 * 2 * evaluations
    rows.clear()
    model.sample(text(), FRAMES, seeds=SEEDS, sampling=replace(SAMPLING, guidance=1.0))
    assert sum(rows) == 26 * evaluations
    rows.clear()
    model.sample(text(), FRAMES, seeds=SEEDS, sampling=replace(SAMPLING, resample_all=True))
    assert sum(rows) > 3 * 26 * 2 * evaluations


def test_guidance_one_runs_the_transformer_once_per_step():
    model, rows = make(), []
    model.blocks[0].register_forward_hook(lambda module, inputs, output: rows.append(len(output)))
    model.sample(text(), FRAMES, seeds=SEEDS, sampling=replace(SAMPLING, guidance=1.0))
    assert set(rows) == {int(FRAMES.sum()) // 4}
    rows.clear()
    model.sample(text(), FRAMES, seeds=SEEDS)
    assert set(rows) == {2 * (int(FRAMES.sum()) // 4)}


def test_guidance_near_one_is_continuous():
    model = make()
    one, near = (
        model.sample(text(), FRAMES, seeds=SEEDS, sampling=replace(SAMPLING, guidance=g)).values
        for g in (1.0, 1.000001)
    )
    torch.testing.assert_close(one, near, rtol=1e-3, atol=1e-3)


def test_pseudo_reorder_changes_nothing_but_rounding():
    model = make()
    plain, sorted_ = (
        model.sample(text(), FRAMES, seeds=SEEDS, sampling=replace(SAMPLING, pseudo_reorder=flag)).values
        for flag in (False, True)
    )
    torch.testing.assert_close(plain, sorted_, rtol=1e-3, atol=1e-4)


def test_training_mode_is_left_alone_and_has_no_dropout_in_samples():
    model = make()
    expected = model.sample(text(), FRAMES, seeds=SEEDS).values
    model.train()
    result = model.sample(text(), FRAMES, seeds=SEEDS).values
    assert torch.equal(result, expected)
    assert model.training
    assert model.blocks[0].training
    assert not result.requires_grad


def test_injected_draws_replace_the_seeds():
    model = make()
    own = model.sample(text(), FRAMES, seeds=SEEDS)
    draws = SampleDraws(SEEDS, FRAMES // 4, 6)
    assert torch.equal(model.sample(text(), FRAMES, seeds=SEEDS * 0, draws=draws).values, own.values)


@pytest.mark.parametrize(
    ("process", "solver"), [("ddpm", "ddim"), ("flow", "sde"), ("flow", "rk4"), ("flow", "dopri5")]
)
def test_solver_override(process, solver):
    sampling = replace(SAMPLING, solver=solver, solver_steps=4)
    assert make(process).sample(text(), FRAMES, seeds=SEEDS, sampling=sampling).values.isfinite().all()


def test_clipped_latents_stay_in_the_training_range():
    model = make("ddpm")
    clipping = replace(SAMPLING, clip_latents=True)
    with pytest.raises(ValueError, match="set_latent_range"):
        model.sample(text(), FRAMES, seeds=SEEDS, sampling=clipping)
    minimum, maximum = -torch.arange(1.0, 7), torch.full((6,), 0.5)
    model.set_latent_range(minimum, maximum)
    copy = make("ddpm")
    copy.load_state_dict(model.state_dict())
    result = copy.sample(text(), FRAMES, seeds=SEEDS, sampling=clipping)
    values = result.values[result.mask]
    assert (values >= minimum).all()
    assert (values <= maximum).all()
    assert not (model.sample(text(), FRAMES, seeds=SEEDS).values <= maximum).all()


# Editing


def known(keep: torch.Tensor) -> Known:
    return Known(latents(), keep)


def test_edit_keeps_bits_and_regenerates_the_rest():
    keep = torch.rand(3, 12, generator=torch.Generator().manual_seed(3)) < 0.5
    keep[1], keep[2] = True, False
    source = latents()
    result = make().sample(text(), None, seeds=SEEDS, known=known(keep))
    kept, free = keep & source.mask, ~keep & source.mask
    assert torch.equal(result.values[kept], source.values[kept])
    assert (result.values[free] != source.values[free]).all()
    assert torch.equal(result.lengths, source.lengths)


def test_edit_with_everything_known_returns_the_source():
    source = latents()
    result = make().sample(text(), FRAMES, seeds=SEEDS, known=known(torch.ones(3, 12, dtype=torch.bool)))
    assert torch.equal(result.values, source.values * source.mask[..., None])


def test_free_positions_of_the_source_do_not_leak():
    keep = torch.zeros(3, 12, dtype=torch.bool)
    keep[:, ::2] = True
    model, source = make(), latents()
    changed = replace(source, values=torch.where(keep[..., None], source.values, 100.0))
    results = [model.sample(text(), None, seeds=SEEDS, known=Known(x, keep)).values for x in (source, changed)]
    assert torch.equal(results[0], results[1])


def test_nothing_known_is_generation():
    model = make()
    edited = model.sample(text(), FRAMES, seeds=SEEDS, known=known(torch.zeros(3, 12, dtype=torch.bool)))
    assert torch.equal(edited.values, model.sample(text(), FRAMES, seeds=SEEDS).values)


@pytest.mark.parametrize("resample_all", [False, True])
def test_mask_free_edit_changes_its_share(resample_all):
    sampling = replace(SAMPLING, edit_fraction=0.25, resample_all=resample_all)
    source = latents()
    free = torch.zeros(3, 12, dtype=torch.bool)
    result = make().sample(text(), None, seeds=SEEDS, known=known(free), sampling=sampling)
    changed = (result.values != source.values).any(dim=2) & source.mask
    assert changed.sum(dim=1).tolist() == [3, 1, 2]


def test_mask_free_edit_needs_a_whole_motion():
    """Between kept stretches there are no latents: what isn't regenerated there would be zeros."""
    sampling, some = replace(SAMPLING, edit_fraction=0.25), torch.zeros(3, 12, dtype=torch.bool)
    some[1, 0] = True
    with pytest.raises(ValueError, match=r"edit_fraction=0\.25 regenerates a share of a motion of which nothing is"):
        make().sample(text(), None, seeds=SEEDS, known=known(some), sampling=sampling)
    with pytest.raises(ValueError, match="nothing is kept"):
        make().sample(text(), FRAMES, seeds=SEEDS, sampling=sampling)


# Errors


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda m: m.sample(text(), torch.tensor([3, 20, 20]), seeds=SEEDS), "cannot generate 3 frames; give 4 to 48"),
        (lambda m: m.sample(text(), torch.tensor([20, 52, 20]), seeds=SEEDS), "cannot generate 52 frames"),
        (lambda m: m.sample(text(), None, seeds=SEEDS), "LengthEstimator"),
        (lambda m: m.sample(text([0, 1]), FRAMES, seeds=SEEDS), "3 lengths, 2 texts and 3 seeds"),
        (
            lambda m: m.sample(text(), FRAMES - 4, seeds=SEEDS, known=known(torch.ones(3, 12, dtype=torch.bool))),
            "pass frames=None",
        ),
        (
            lambda m: m.sample(text(), FRAMES, seeds=SEEDS, known=known(torch.ones(3, 5, dtype=torch.bool))),
            "one mask entry",
        ),
        (
            lambda m: m.loss(Latents(FRAMES // 4, FRAMES, codes=torch.zeros(3, 12, 1, dtype=torch.long)), text()),
            "not for codes",
        ),
        (lambda m: m.loss(replace(latents(), values=torch.zeros(3, 12, 7)), text()), "not for values of 7 channels"),
        (lambda m: m.loss(replace(latents(), values=torch.zeros(3, 13, 6)), text()), "exceed max_latents=12"),
        (lambda m: m.set_latent_range(torch.ones(6), torch.zeros(6)), "minimum exceeds"),
        (lambda m: make(mask_length="half"), "MARDM.mask_length=half: must be one of padded, own"),
        (lambda m: make(heads=3), "heads 3"),
        (lambda m: replace(SAMPLING, steps=0), "MarSampling.steps=0: must be a whole number from 1"),
        (
            lambda m: replace(SAMPLING, edit_fraction=2.0),
            "MarSampling.edit_fraction=2.0: must be .* <= 1",
        ),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call(make())


def test_a_solver_of_another_process_is_refused_when_the_model_is_built():
    with pytest.raises(ValueError, match="'ddim' is unknown to Flow"):
        MARDM(latent_dim=6, text_dim=5, process=Flow(), sampling=MarSampling(solver="ddim"))


def test_published_size_has_the_published_number_of_parameters():
    with torch.device("meta"):
        model = MARDM(latent_dim=512, text_dim=512, process=DDPM())
    assert sum(p.numel() for p in model.parameters()) == 19_940_864 + 270_875_648


def test_initialisation():
    """Compare with MARDM §4: N(0, 0.02) Linears, zero biases, modulations and mask latent."""
    torch.manual_seed(0)
    model = MARDM(latent_dim=64, text_dim=64, process=Flow(), width=128, heads=4, mlp_width=8, mlp_depth=1)
    assert not model.mask_latent.any()
    assert not model.blocks[0].modulation[1].weight.any()
    for layer in (
        model.input_projection,
        model.text_projection,
        model.blocks[0].attention.proj,
        model.blocks[0].mlp[2],
    ):
        assert layer.weight.std().item() == pytest.approx(0.02, rel=0.05)
        assert not layer.bias.any()


def test_words_are_read_and_how_many_are_hidden_is_not():
    model = make("words")
    batch, full = latents(), text()
    shuffled = replace(full, tokens=full.tokens.flip(0) * full.token_mask[..., None])
    assert not torch.allclose(
        model(batch.values, full, batch.mask), model(batch.values, shuffled, batch.mask), atol=1e-3
    )
    fewer = replace(full, token_mask=full.token_mask & (torch.arange(6) < 2))
    nothing = [model(batch.values, without_words(given), batch.mask) for given in (full, fewer)]
    close(*nothing)
    with pytest.raises(ValueError, match="reads_tokens: true"):
        model(batch.values, replace(full, tokens=None, token_mask=None), batch.mask)


def differ(first: Latents, second: Latents) -> bool:
    return (first.values - second.values).abs().max().item() > 1e-3


def test_the_temperature_reaches_the_process():
    made = [
        make("ddpm").sample(text(), FRAMES, seeds=SEEDS, sampling=replace(SAMPLING, temperature=warm))
        for warm in (0.0, 1.0)
    ]
    assert differ(*made)


def test_the_grid_of_times_reaches_the_process():
    grids = [replace(SAMPLING, solver="euler", solver_steps=4, solver_grid=grid) for grid in ("uniform", "emergence")]
    assert differ(*(make("flow").sample(text(), FRAMES, seeds=SEEDS, sampling=one) for one in grids))

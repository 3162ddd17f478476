"""Test MoMask's masked transformer: training loss, generation, edits, invariances and errors."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import pytest
import torch

from kinema.decoding.draws import SeededDraws
from kinema.generators.momask.model import MoMask, MoMaskDraws, MoMaskSampling, corrupt, likely_choice, select
from kinema.masking import cosine_counts
from kinema.nn import ranks
from kinema.types import Known, Latents, TextFeatures, frame_mask

CODES = 30
FRAMES = torch.tensor([48, 20, 36])
SEEDS = torch.tensor([11, 12, 13])
SAMPLING = MoMaskSampling(steps=6, guidance=2.5, top_k=0.5)


def make(**options) -> MoMask:
    """Make a tiny model whose weights are large enough that everything has an influence."""
    torch.manual_seed(0)
    sizes = {"width": 16, "feedforward": 24, "layers": 2, "heads": 2, "dropout": 0.3}
    model = MoMask(codebook_size=CODES, code_dim=6, text_dim=5, max_latents=12, sampling=SAMPLING, **(sizes | options))
    for parameter in model.parameters():
        if parameter.ndim > 1:
            torch.nn.init.normal_(parameter, std=0.4)
    return model.eval()


def text(rows: list[int] | None = None) -> TextFeatures:
    pooled = torch.randn(4, 5, generator=torch.Generator().manual_seed(1))
    rows = [0, 1, 2] if rows is None else rows
    return TextFeatures([str(i) for i in rows], pooled[rows])


def latents(frames: torch.Tensor = FRAMES, quantizers: int = 1) -> Latents:
    lengths = frames // 4
    codes = torch.randint(CODES, (4, 12, quantizers), generator=torch.Generator().manual_seed(2))
    return Latents(lengths=lengths, frames=frames, codes=codes[: len(frames), : int(lengths.max())])


def draws(samples: int = 3, seed: int = 0, condition_drop: float = 0.1) -> MoMaskDraws:
    generator = torch.Generator().manual_seed(seed)
    return MoMaskDraws.draw(
        (samples, 12), CODES, condition_drop=condition_drop, generator=generator, device=torch.device("cpu")
    )


def close(a: torch.Tensor, b: torch.Tensor) -> None:
    torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-5)


# Training


def test_every_parameter_learns():
    model = make().train()
    model.loss(latents(), text(), generator=torch.Generator().manual_seed(0))["loss"].backward()
    assert [name for name, p in model.named_parameters() if p.grad is None or not p.grad.any()] == []


def test_loss_is_a_function_of_the_generator():
    model = make()
    first, again, other = (
        model.loss(latents(), text(), generator=torch.Generator().manual_seed(seed))["loss"] for seed in (3, 3, 4)
    )
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_padding_never_reaches_the_loss():
    """Give garbage in the padding, and more padding; codes of further layers are not read."""
    model = make()
    clean = latents(torch.tensor([20, 20, 36]))
    garbage = replace(clean, codes=torch.where(clean.mask[..., None], clean.codes, 999))
    wider = replace(clean, codes=torch.nn.functional.pad(garbage.codes, (0, 2, 0, 3), value=7))
    losses = [
        model.loss(x, text(), draws=draws().crop(slice(None), x.codes.shape[1]))["loss"]
        for x in (clean, garbage, wider)
    ]
    assert torch.equal(losses[0], losses[1])
    close(losses[0], losses[2])


def test_masked_codes_do_not_leak_into_the_input():
    drawn = replace(draws(), to_mask=torch.ones(3, 12, dtype=torch.bool))
    codes = latents().codes[..., 0]
    selected = select(drawn, latents().mask, 12)
    assert selected.any()
    changed = torch.where(selected, (codes + 1) % CODES, codes)
    assert torch.equal(corrupt(codes, selected, CODES, drawn), corrupt(changed, selected, CODES, drawn))


def test_corruption_shares():
    """Compare with 10 % random codes, 79.2 % MASK, 10.8 % unchanged (MoMask §2)."""
    drawn = replace(draws(samples=500), random_codes=torch.full((500, 12), 5))
    out = corrupt(torch.full((500, 12), 9), torch.ones(500, 12, dtype=torch.bool), CODES, drawn)
    shares = [(out == value).float().mean().item() for value in (9, CODES, 5)]
    assert shares == pytest.approx([0.108, 0.792, 0.1], abs=0.015)
    assert drawn.condition_drop.float().mean().item() == pytest.approx(0.1, abs=0.04)


def test_selection_counts_padded_slots():
    """Expect max(1, round(12 cos)) of 12 slots, of which a short motion has only some."""
    drawn = replace(draws(), mask_time=torch.tensor([0.0, 2 / 3, 1.0]), permutation=torch.arange(12).repeat(3, 1))
    assert select(drawn, frame_mask(torch.tensor([5, 12, 12]), 12), 12).sum(dim=1).tolist() == [5, 6, 1]


def test_ranks_average_to_the_loss_of_one_process(monkeypatch):
    """Let two ranks of different row counts share them as a process group does."""
    model, batch = make(), latents(torch.tensor([48, 20, 36, 8]))

    def losses(rows: list[int], shard: tuple[int, int]) -> torch.Tensor:
        part = Latents(batch.lengths[rows], batch.frames[rows], codes=batch.codes[rows])
        found = model.loss(part, text(rows), generator=torch.Generator().manual_seed(5), shard=shard)
        return torch.stack((found["loss"], found["accuracy"]))

    whole = losses([0, 1, 2, 3], (0, 1))
    counts = []
    monkeypatch.setattr(ranks.distributed, "is_initialized", lambda: True)
    monkeypatch.setattr(ranks.distributed, "all_reduce", lambda rows: counts.append(rows.item()))
    for rank in (0, 1):
        losses([2 * rank, 2 * rank + 1], (rank, 2))
    total = counts[0] + counts[2]
    assert counts[0] != counts[2]
    monkeypatch.setattr(ranks.distributed, "all_reduce", lambda rows: rows.fill_(total))
    close(torch.stack([losses([2 * rank, 2 * rank + 1], (rank, 2)) for rank in (0, 1)]).mean(dim=0), whole)


def test_condition_is_dropped_in_training_only():
    drop_all, batch = make(condition_drop=1.0, dropout=0.0), latents()
    other = TextFeatures(["", "", ""], torch.randn(3, 5, generator=torch.Generator().manual_seed(9)))

    def losses() -> list[torch.Tensor]:
        return [drop_all.loss(batch, t, generator=torch.Generator().manual_seed(0))["loss"] for t in (text(), other)]

    assert not torch.equal(*losses())
    drop_all.train()
    assert torch.equal(*losses())


def test_a_batch_without_selected_positions_has_loss_zero():
    drawn = replace(draws(), permutation=torch.full((3, 12), 99))
    losses = make().loss(latents(), text(), draws=drawn)
    losses["loss"].backward()
    assert losses["loss"].item() == losses["accuracy"].item() == 0


# Generation


def test_samples_do_not_depend_on_batch_order_or_padding():
    model = make()
    together = model.sample(text(), FRAMES, seeds=SEEDS)
    for rows in ([1], [2, 1], [2, 0, 1]):
        some = model.sample(text(rows), FRAMES[rows], seeds=SEEDS[rows])
        for i, row in enumerate(rows):
            length = int(together.lengths[row])
            assert torch.equal(some.codes[i, :length], together.codes[row, :length])


def test_seed_text_guidance_and_temperature_matter():
    model = make()
    base = model.sample(text(), FRAMES, seeds=SEEDS).codes
    assert torch.equal(base, model.sample(text(), FRAMES, seeds=SEEDS).codes)
    for other in (
        model.sample(text(), FRAMES, seeds=SEEDS + 10),
        model.sample(text([2, 0, 1]), FRAMES, seeds=SEEDS),
        model.sample(text(), FRAMES, seeds=SEEDS, sampling=replace(SAMPLING, guidance=1.0)),
        model.sample(text(), FRAMES, seeds=SEEDS, sampling=replace(SAMPLING, temperature=0)),
    ):
        assert not torch.equal(base, other.codes)


def test_temperature_zero_needs_no_seed():
    model, greedy = make(), replace(SAMPLING, temperature=0)
    first, second = (model.sample(text(), FRAMES, seeds=seeds, sampling=greedy).codes for seeds in (SEEDS, SEEDS + 10))
    assert torch.equal(first, second)


def test_result_counts_whole_latents_and_has_zero_padding():
    result = make().sample(text(), torch.tensor([49, 20, 7]), seeds=SEEDS)
    assert result.lengths.tolist() == [12, 5, 1]
    assert result.frames.tolist() == [48, 20, 4]
    assert not result.codes[~result.mask].any()
    assert 0 <= result.codes.min() <= result.codes.max() < CODES


def inputs_of(model: MoMask, **request) -> torch.Tensor:
    """Collect the ids that the network is given at every step."""
    seen = []
    model.register_forward_pre_hook(lambda module, inputs: seen.append(inputs[0]))
    request = {"frames": FRAMES, "seeds": SEEDS, "sampling": replace(SAMPLING, guidance=1.0)} | request
    result = model.sample(text(), request.pop("frames"), **request)
    return torch.stack([*seen, result.codes[..., 0]])


def test_each_slot_is_decoded_once_on_the_cosine_schedule():
    ids = inputs_of(make())
    masked = ids == CODES
    lengths = FRAMES // 4
    assert torch.equal(masked[:-1].sum(dim=2), cosine_counts(lengths, 6))
    released = masked[:-1] & ~masked[1:]
    assert torch.equal(released.sum(dim=0), frame_mask(lengths, 12).long())
    for before, after in pairwise(ids):
        stays = (before < CODES) & frame_mask(lengths, 12)
        assert torch.equal(before[stays], after[stays])


def test_surest_slots_are_kept():
    """Compare the slots masked at the second step with the least likely codes of the first."""
    model = make()
    ids = inputs_of(model, sampling=replace(SAMPLING, guidance=1.0, temperature=0))
    likely = model(ids[0], text().pooled, latents().mask).softmax(-1).amax(-1)
    for row, length, count in zip(range(3), (12, 5, 9), cosine_counts(FRAMES // 4, 6)[1].tolist(), strict=True):
        least = likely[row, :length].argsort()[:count]
        assert sorted(least.tolist()) == (ids[1, row] == CODES).nonzero()[:, 0].tolist()


def test_guidance_one_runs_half_the_rows():
    model, rows = make(), []
    model.encoder.blocks[0].register_forward_hook(lambda module, inputs, output: rows.append(len(output)))
    once = int(FRAMES.sum()) // 4 + 3  # tokens, and a text a sample
    for guidance, expected in ((1.0, once), (2.0, 2 * once)):
        rows.clear()
        model.sample(text(), FRAMES, seeds=SEEDS, sampling=replace(SAMPLING, guidance=guidance))
        assert rows == [expected] * SAMPLING.steps


@pytest.mark.parametrize(("classes", "kept"), [(30, 3), (24, 3), (512, 52)])
def test_published_share_of_classes(classes, kept):
    """Count the classes that can be drawn: (1 - 0.9) * 30 is 2.999... in Python floats (COMMON §8)."""
    logits = torch.arange(float(classes)).mul(1e-3).expand(1, 20_000, classes)
    drawn = likely_choice(SeededDraws(torch.tensor([0])), 1.0, 0.9)(0, logits)
    assert drawn.unique().tolist() == list(range(classes - kept, classes))


def test_mode_is_left_alone_and_samples_have_no_dropout():
    model = make()
    expected = model.sample(text(), FRAMES, seeds=SEEDS).codes
    model.train()
    assert torch.equal(model.sample(text(), FRAMES, seeds=SEEDS).codes, expected)
    assert model.training
    assert model.encoder.blocks[0].training


def test_injected_draws_replace_the_seeds():
    model = make()
    own = model.sample(text(), FRAMES, seeds=SEEDS).codes
    assert torch.equal(model.sample(text(), FRAMES, seeds=SEEDS * 0, draws=SeededDraws(SEEDS)).codes, own)


# Editing


def test_edit_keeps_codes_and_regenerates_the_rest():
    keep = torch.rand(3, 12, generator=torch.Generator().manual_seed(3)) < 0.5
    keep[1], keep[2] = True, False
    source, model = latents(), make()
    result = model.sample(text(), None, seeds=SEEDS, known=Known(source, keep))
    kept = keep & source.mask
    assert torch.equal(result.codes[kept], source.codes[kept])
    assert torch.equal(result.lengths, source.lengths)
    masked = inputs_of(model, known=Known(source, keep))[0] == CODES
    assert torch.equal(masked, ~keep & source.mask)


def test_free_positions_of_the_source_do_not_leak():
    keep = torch.zeros(3, 12, dtype=torch.bool)
    keep[:, ::2] = True
    model, source = make(), latents()
    changed = replace(source, codes=torch.where(keep[..., None], source.codes, 0))
    results = [model.sample(text(), None, seeds=SEEDS, known=Known(x, keep)).codes for x in (source, changed)]
    assert torch.equal(results[0], results[1])


def test_nothing_known_is_generation():
    model = make()
    nothing = Known(latents(), torch.zeros(3, 12, dtype=torch.bool))
    edited = model.sample(text(), FRAMES, seeds=SEEDS, known=nothing)
    assert torch.equal(edited.codes, model.sample(text(), FRAMES, seeds=SEEDS).codes)


# Errors


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda m: m.sample(text(), torch.tensor([3, 20, 20]), seeds=SEEDS), "cannot generate 3 frames; give 4 to 48"),
        (lambda m: m.sample(text(), None, seeds=SEEDS), "LengthEstimator"),
        (lambda m: m.loss(replace(latents(), codes=torch.full((3, 12, 1), CODES)), text()), f"token id {CODES} is out"),
        (lambda m: m.loss(Latents(FRAMES // 4, FRAMES, torch.zeros(3, 12, 6)), text()), "continuous values"),
        (lambda m: make(heads=3), "heads 3"),
        (lambda m: MoMaskSampling(steps=0), "MoMaskSampling.steps=0: must be a whole number from 1"),
        (lambda m: MoMaskSampling(temperature=-1), "MoMaskSampling.temperature=-1: must be a finite number >= 0"),
        (
            lambda m: MoMaskSampling(residual_top_k=1.0),
            "MoMaskSampling.residual_top_k=1.0: must be .* < 1",
        ),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call(make())


def test_published_size_has_the_published_number_of_parameters():
    with torch.device("meta"):
        model = MoMask(codebook_size=512, code_dim=512, text_dim=512)
    assert sum(p.numel() for p in model.parameters()) == 12_048_768

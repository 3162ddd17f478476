"""Test BAD: who may influence whom, training, both samplers, edits, invariances and errors."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from kinema.decoding.draws import SeededDraws
from kinema.generators.bad.model import BAD
from kinema.generators.bad.sampling import BadSampling
from kinema.generators.bad.training import BadDraws
from kinema.masking import hybrid_mask, paper_counts, shrinking_counts
from kinema.types import Known, Latents, TextFeatures, frame_mask

CODES = 30
FRAMES = torch.tensor([48, 20, 36])
LENGTHS = FRAMES // 4
SEEDS = torch.tensor([11, 12, 13])
SAMPLERS = {
    "oaas": BadSampling(),
    "oaas_drawn": BadSampling(temperature=1.0),
    "arranged": BadSampling(orders="arranged"),
    "cbs": BadSampling(sampler="cbs"),
    "cbs_greedy": BadSampling(sampler="cbs", temperature=0),
    "rs": BadSampling(sampler="rs", temperature=0.7),
    "published": BadSampling(official_inference_mask=True),
}


def make(**options) -> BAD:
    """Make a tiny model whose weights are large enough that everything has an influence."""
    torch.manual_seed(0)
    sizes = {"width": 16, "feedforward": 24, "heads": 2, "cross_layers": 1, "base_layers": 1, "head_layers": 1}
    sizes |= {"dropout": 0.3, "max_latents": 12}
    model = BAD(codebook_size=CODES, code_dim=6, text_dim=5, token_dim=7, **(sizes | options))
    for parameter in model.parameters():
        if parameter.ndim > 1:
            torch.nn.init.normal_(parameter, std=0.4)
    model.set_codebook(torch.randn(CODES, 6))
    return model.eval()


def text(rows: list[int] | None = None, padding: int = 0) -> TextFeatures:
    generator = torch.Generator().manual_seed(1)
    pooled, words = torch.randn(4, 5, generator=generator), torch.randn(4, 6, 7, generator=generator)
    rows = [0, 1, 2] if rows is None else rows
    real = frame_mask(torch.tensor([6, 3, 4, 5]), 6 + padding)
    words = torch.cat((words, torch.full((4, padding, 7), 9.0)), dim=1)
    return TextFeatures([str(i) for i in rows], pooled[rows], words[rows], real[rows])


def latents(lengths: torch.Tensor = LENGTHS) -> Latents:
    codes = torch.randint(CODES, (4, 12, 1), generator=torch.Generator().manual_seed(2))
    return Latents(lengths, lengths * 4, codes=codes[: len(lengths), : int(lengths.max())])


def draw(samples: int = 3, positions: int = 12, seed: int = 0, **options) -> BadDraws:
    options = {"max_replaced": 0.4, "low_mask_share": 0.1} | options
    generator = torch.Generator().manual_seed(seed)
    return BadDraws.draw((samples, positions), CODES, **options, generator=generator, device=torch.device("cpu"))


def close(a: torch.Tensor, b: torch.Tensor) -> None:
    torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-5)


# Who may influence whom


@pytest.mark.parametrize("direction", ["ge", "le"])
@pytest.mark.parametrize("time_token", [True, False])
def test_what_a_row_may_not_see_does_not_change_its_output(time_token, direction):
    """Perturb one token's embedding at a time, with one block: a row's bits change if and only if it may see it."""
    model = make(time_token=time_token, direction=direction, base_layers=0, cross_layers=0)
    codes, orders = latents().codes[..., 0], torch.stack([torch.randperm(12) for _ in range(3)])
    masked = (torch.rand(3, 12, generator=torch.Generator().manual_seed(3)) < 0.6) & frame_mask(LENGTHS, 12)
    table, ahead = model.transformer.special.weight, model.conditions
    visible = hybrid_mask(
        torch.nn.functional.pad(orders, (0, 1)), torch.nn.functional.pad(masked, (0, 1)), LENGTHS, **model.rules
    )
    plain = model(codes, masked, orders, LENGTHS, text())
    for row, slot in frame_mask(LENGTHS, 12).nonzero().tolist():
        kept, changed = table.detach().clone(), codes.clone()
        changed[row, slot] = (changed[row, slot] + 1) % CODES
        with torch.no_grad():
            if masked[row, slot]:
                table[2 + orders[row, slot]] += 1.0
            output = model(changed, masked, orders, LENGTHS, text())
            table.copy_(kept)
        reached = (output[row] != plain[row]).any(dim=-1)
        computed = torch.arange(len(reached)) <= ahead + LENGTHS[row]  # padding isn't
        assert torch.equal(reached, visible[row, :, ahead + slot] & computed)


def test_masks_of_lower_order_have_no_influence_through_any_number_of_blocks():
    """Show that the leak is closed as a whole: with arranged orders, the output of masks behind a mask is its own."""
    model = make(base_layers=2, head_layers=2, time_token=False)
    codes = latents().codes[..., 0]
    orders, masked = torch.arange(12).expand(3, 12), frame_mask(LENGTHS, 12)
    plain = model(codes, masked, orders, LENGTHS, text())
    with torch.no_grad():
        model.transformer.special.weight[2] += 3.0  # the mask token of order 0, the first position's
    changed = model(codes, masked, orders, LENGTHS, text())
    assert torch.equal(changed[:, 2:], plain[:, 2:])
    assert not torch.equal(changed[:, 1], plain[:, 1])


def test_codes_behind_a_mask_and_padding_do_not_leak():
    model, batch = make(), latents()
    drawn = draw()
    clean = model.loss(batch, text(), draws=drawn)["loss"]
    garbage = batch.codes.masked_fill(~batch.mask[..., None], 7)
    assert torch.equal(model.loss(replace(batch, codes=garbage), text(), draws=drawn)["loss"], clean)
    masked = torch.ones(3, 12, dtype=torch.bool)
    orders = torch.arange(12).expand(3, 12)
    other = (batch.codes[..., 0] + 1) % CODES
    first, second = (model(codes, masked, orders, LENGTHS, text()) for codes in (batch.codes[..., 0], other))
    assert torch.equal(first, second)


def test_padding_of_words_is_hidden_and_refused_where_all_are_read():
    close(*(make().loss(latents(), text(padding=p), draws=draw())["loss"] for p in (0, 3)))
    with pytest.raises(ValueError, match="words='all' reads all positions"):
        make(words="all").loss(latents(), text(padding=3), draws=draw())


def test_time_token_tells_masks_and_length():
    model = make()
    masked = frame_mask(torch.tensor([3, 3, 5]), 12)
    tokens = model.time_token(masked, torch.tensor([9, 9, 9]))
    close(tokens[0], tokens[1])
    assert not torch.allclose(tokens[0], tokens[2], atol=1e-3)
    assert not torch.allclose(tokens[0], model.time_token(masked, torch.tensor([8, 9, 9]))[0], atol=1e-3)
    assert make(time_token=False).time_token(masked, LENGTHS) is None


# Training


@pytest.mark.parametrize("time_token", [True, False])
def test_every_parameter_learns(time_token):
    model = make(time_token=time_token).train()
    model.loss(latents(), text(), generator=torch.Generator().manual_seed(0))["loss"].backward()
    assert [name for name, p in model.named_parameters() if p.grad is None or not p.grad.any()] == []


def test_loss_is_a_function_of_the_generator():
    model = make()
    first, again, other = (
        model.loss(latents(), text(), generator=torch.Generator().manual_seed(seed))["loss"] for seed in (3, 3, 4)
    )
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_loss_covers_all_codes_of_each_sample_and_counts_samples_alike():
    model, batch, drawn = make(), latents(), draw()
    parts = []
    for row in range(3):
        part = Latents(batch.lengths[[row]], batch.frames[[row]], codes=batch.codes[[row], : int(LENGTHS[row])])
        size = part.codes.shape[1]
        parts.append(model.loss(part, text([row]), draws=drawn.crop(slice(row, row + 1), size))["loss"])
    close(model.loss(batch, text(), draws=drawn)["loss"], torch.stack(parts).mean())
    everything_seen = replace(drawn, ratio=torch.zeros(3))  # one masked position is the least
    assert model.loss(batch, text(), draws=everything_seen)["loss"] > 0.1


def test_two_ranks_average_to_the_loss_of_one_process():
    """Let each rank draw for the whole batch: also the one coin is the same for both."""
    model, batch = make(), latents(torch.tensor([12, 5, 9, 2]))
    rows = [[0, 1, 2, 3], [0, 1], [2, 3]]
    losses = []
    for part, shard in zip(rows, ((0, 1), (0, 2), (1, 2)), strict=True):
        some = Latents(batch.lengths[part], batch.frames[part], codes=batch.codes[part])
        generator = torch.Generator().manual_seed(5)
        losses.append(model.loss(some, text(part), generator=generator, shard=shard)["loss"])
    close(losses[0], (losses[1] + losses[2]) / 2)


def test_codes_are_replaced_in_training_only(monkeypatch):
    """Replace everything: the loss then depends on the replacements, in eval mode not."""
    model, batch = make(dropout=0.0, max_replaced=1.0), latents()
    drawn = draw(max_replaced=1.0)
    monkeypatch.setattr(BadDraws, "draw", classmethod(lambda cls, *a, **k: replace(drawn, keep=drawn.keep & False)))
    model.train()
    replaced = model.loss(batch, text())["loss"]
    close(replaced, model.loss(batch, text(), draws=replace(drawn, keep=drawn.keep & False))["loss"])
    model.eval()
    kept = model.loss(batch, text())["loss"]
    close(kept, model.loss(batch, text(), draws=replace(drawn, keep=drawn.keep | True))["loss"])
    assert (kept - replaced).abs() > 1e-3


def test_shares_of_the_draws():
    """Compare with BAD §3: 20 % replaced on average, at most 40 % of a sample; ratio U(.5, 1), one low batch of ten."""
    drawn = draw(400, 500, low_mask_share=0.0)
    replaced = 1 - drawn.keep.float().mean(dim=1)
    assert replaced.mean().item() == pytest.approx(0.2, abs=0.02)
    assert replaced.max() < 0.5
    assert replaced.std().item() == pytest.approx(0.4 / 12**0.5, abs=0.02)
    assert drawn.ratio.min() > 0.5
    assert drawn.ratio.max() < 1.0
    coins = torch.stack([draw(3, 1, seed).ratio < 0.5 for seed in range(600)])
    assert torch.equal(coins.any(dim=1), coins.all(dim=1))
    assert coins[:, 0].float().mean().item() == pytest.approx(0.1, abs=0.04)


# Generation


@pytest.mark.parametrize("sampling", SAMPLERS.values(), ids=SAMPLERS)
def test_samples_do_not_depend_on_batch_order_or_padding(sampling):
    model = make()
    together = model.sample(text(), FRAMES, seeds=SEEDS, sampling=sampling)
    for rows in ([2, 1], [1, 2], [2, 0, 1]):
        some = model.sample(text(rows, padding=2), FRAMES[rows], seeds=SEEDS[rows], sampling=sampling)
        for i, row in enumerate(rows):
            length = int(together.lengths[row])
            assert torch.equal(some.codes[i, :length], together.codes[row, :length])
    alone = model.sample(
        text([2]), FRAMES[[2]], seeds=SEEDS[[2]], sampling=replace(sampling, official_inference_mask=False)
    )
    if not sampling.official_inference_mask:  # which stops early for a batch of one
        assert torch.equal(alone.codes[0], together.codes[2, :9])


@pytest.mark.parametrize("sampling", SAMPLERS.values(), ids=SAMPLERS)
def test_every_position_is_decoded_and_what_is_kept_stays(sampling):
    model, before = make(), None
    steps = list(model.trajectory(text(), FRAMES, seeds=SEEDS, sampling=sampling))
    counts = shrinking_counts(LENGTHS, 10)
    assert len(steps) == 10
    for i, (masked, _, result) in enumerate(steps):
        assert masked.sum(dim=1).tolist() == counts[i].tolist()
        if before is not None:
            previous, codes = before
            assert not (masked & ~previous).any()
            assert torch.equal(codes[~masked], result.codes[..., 0][~masked])
        before = masked, result.codes[..., 0]
    assert torch.equal(steps[0][0], frame_mask(LENGTHS, 12))
    assert not result.codes[~result.mask].any()
    assert result.lengths.tolist() == [12, 5, 9]
    assert result.frames.tolist() == [48, 20, 36]


def test_oaas_keeps_tokens_in_the_order_of_the_permutation():
    drawn = SeededDraws(SEEDS).order(12).masked_fill(~frame_mask(LENGTHS, 12), torch.inf)
    orders = drawn.argsort(dim=1).argsort(dim=1)
    for direction, first in (
        ("ge", lambda kept, left: kept.max() < left.min()),
        ("le", lambda k, m: k.min() > m.max()),
    ):
        model = make(direction=direction)
        for masked, _, _ in list(model.trajectory(text(), FRAMES, seeds=SEEDS))[1:]:
            for row in range(3):
                real = orders[row, : int(LENGTHS[row])]
                hidden = masked[row, : int(LENGTHS[row])]
                assert first(real[~hidden], real[hidden]) or not (~hidden).any()


def test_cbs_keeps_what_it_is_sure_of():
    model = make()
    steps = list(model.trajectory(text(), FRAMES, seeds=SEEDS, sampling=SAMPLERS["cbs_greedy"]))
    orders = SeededDraws(SEEDS).order(12).masked_fill(~frame_mask(LENGTHS, 12), torch.inf)
    orders = orders.argsort(dim=1).argsort(dim=1)
    masked = steps[0][0]
    zeros = torch.zeros(3, 12, dtype=torch.long)
    sure = model(zeros, masked, orders, LENGTHS, text())[:, 2:-1].softmax(-1).max(-1).values
    hidden = steps[1][0]
    for row in range(3):
        own = masked[row]
        assert sure[row][own & ~hidden[row]].min() > sure[row][hidden[row]].max() or not (own & ~hidden[row]).any()


def test_our_mask_follows_what_is_masked_now_and_the_published_one_does_not():
    model = make()
    ours, published = (
        list(model.trajectory(text(), FRAMES, seeds=SEEDS, sampling=BadSampling(official_inference_mask=flag)))
        for flag in (False, True)
    )
    for masked, visible, _ in ours:
        decoded = torch.nn.functional.pad(~masked & frame_mask(LENGTHS, 12), (2, 1))
        hidden = torch.nn.functional.pad(masked, (2, 1))
        assert not visible[decoded[:, :, None] & hidden[:, None]].any()
    masked, visible, _ = published[5]
    decoded = torch.nn.functional.pad(~masked & frame_mask(LENGTHS, 12), (2, 1))
    assert visible[decoded[:, :, None] & torch.nn.functional.pad(masked, (2, 1))[:, None]].any()


@pytest.mark.parametrize(("frames", "steps"), [(4, 10), (12, 2), (40, 1), (60, 3), (96, 5), (196, 10)])
def test_the_published_sampler_stops_early_for_a_batch_of_one(frames, steps):
    """Compare with the iterations that BAD §4 measured."""
    model, one = make(max_latents=49), BadSampling(official_inference_mask=True)
    for sampling, expected in ((one, steps), (BadSampling(), 10)):
        run = model.trajectory(text([0]), torch.tensor([frames]), seeds=SEEDS[:1], sampling=sampling)
        assert len(list(run)) == expected


def test_seed_text_and_sampler_matter():
    model, own = make(), BadSampling(steps=40)  # 10 for 12 positions
    base = model.sample(text(), FRAMES, seeds=SEEDS, sampling=own).codes
    assert torch.equal(base, model.sample(text(), FRAMES, seeds=SEEDS, sampling=own).codes)
    others = [
        model.sample(text(rows), FRAMES, seeds=s, sampling=own) for rows, s in ((None, SEEDS + 10), ([2, 0, 1], SEEDS))
    ]
    for name, sampling in SAMPLERS.items():
        if name != "oaas":
            others.append(model.sample(text(), FRAMES, seeds=SEEDS, sampling=replace(sampling, steps=40)))
    for other in others:
        assert not torch.equal(base, other.codes)


def test_training_mode_is_left_alone_and_has_no_dropout_in_samples():
    model = make()
    expected = model.sample(text(), FRAMES, seeds=SEEDS).codes
    model.train()
    assert torch.equal(model.sample(text(), FRAMES, seeds=SEEDS).codes, expected)
    assert model.training
    assert model.transformer.training


def test_injected_draws_replace_the_seeds():
    model = make()
    for sampling in (SAMPLERS["oaas_drawn"], SAMPLERS["cbs"]):
        own = model.sample(text(), FRAMES, seeds=SEEDS, sampling=sampling)
        injected = model.sample(text(), FRAMES, seeds=SEEDS * 0, sampling=sampling, draws=SeededDraws(SEEDS))
        assert torch.equal(injected.codes, own.codes)


# Editing


def known(keep: torch.Tensor) -> Known:
    return Known(latents(), keep)


def half() -> torch.Tensor:
    return torch.rand(3, 12, generator=torch.Generator().manual_seed(3)) < 0.5


@pytest.mark.parametrize("sampling", SAMPLERS.values(), ids=SAMPLERS)
def test_edit_keeps_codes_and_decodes_the_free_ones_only(sampling):
    keep, source = half(), latents()
    keep[1] = True
    steps = list(make().trajectory(text(), None, seeds=SEEDS, known=known(keep), sampling=sampling))
    kept, free = keep & source.mask, ~keep & source.mask
    assert torch.equal(steps[0][0], free)
    for masked, _, result in steps:
        assert not (masked & ~free).any()
        assert torch.equal(result.codes[kept], source.codes[kept])
    assert result.codes[free].min() >= 0
    assert torch.equal(result.lengths, source.lengths)
    assert not result.codes[~source.mask].any()


def test_edit_takes_orders_out_of_the_whole_length_as_training_does():
    """Compare with the published edits, whose orders are those of the free positions alone (BAD §5)."""
    keep, source = half(), latents()
    free = ~keep & source.mask
    for official in (False, True):
        model, seen = make(), []
        model.transformer.register_forward_pre_hook(lambda module, inputs, seen=seen: seen.append(inputs[0]))
        sampling = BadSampling(official_inference_mask=official)
        model.sample(text(), None, seeds=SEEDS, known=known(keep), sampling=sampling)
        orders = (seen[0][:, :12] - model.first_mask)[free]
        rows = free.nonzero()[:, 0]
        contiguous = [sorted(orders[rows == i].tolist()) == list(range(int(free[i].sum()))) for i in range(3)]
        assert all(contiguous) == official
        assert orders.min() >= 0
        assert (orders < LENGTHS[rows]).all()


def test_free_codes_of_the_source_do_not_leak():
    keep, source, model = half(), latents(), make()
    changed = replace(source, codes=torch.where(keep[..., None], source.codes, 5))
    first, second = (model.sample(text(), None, seeds=SEEDS, known=Known(x, keep)).codes for x in (source, changed))
    assert torch.equal(first, second)


def test_edit_with_everything_known_returns_the_source_and_with_nothing_generates():
    model, source = make(), latents()
    everything = torch.ones(3, 12, dtype=torch.bool)
    result = model.sample(text(), FRAMES, seeds=SEEDS, known=known(everything))
    assert torch.equal(result.codes, source.codes * source.mask[..., None])
    nothing = model.sample(text(), FRAMES, seeds=SEEDS, known=known(~everything))
    assert torch.equal(nothing.codes, model.sample(text(), FRAMES, seeds=SEEDS).codes)


# Errors


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda m: m.sample(text(), None, seeds=SEEDS), "frames is None"),
        (lambda m: m.sample(text(), torch.tensor([20, 52, 20]), seeds=SEEDS), "cannot generate 52 frames"),
        (lambda m: m.sample(replace(text(), tokens=None), FRAMES, seeds=SEEDS), "reads_tokens: true"),
        (lambda m: m.loss(replace(latents(), codes=torch.full((3, 12, 1), 30)), text()), "token id 30 is out of range"),
        (lambda m: m.set_codebook(torch.zeros(4, 6)), r"codebook is \(4, 6\)"),
        (lambda m: make(direction="up"), "BAD.direction=up: must be one of ge, le"),
        (lambda m: make(max_replaced=1.5), "BAD.max_replaced=1.5: must be a finite number >= 0 and <= 1"),
        (lambda m: make(low_mask_share=-1), "BAD.low_mask_share=-1: must be"),
        (lambda m: BadSampling(sampler="ddim"), "BadSampling.sampler=ddim: must be one of oaas, cbs, rs"),
        (lambda m: BadSampling(orders="sorted"), "BadSampling.orders=sorted: must be one of random, arranged"),
        (lambda m: BadSampling(steps=0), "BadSampling.steps=0: must be a whole number from 1"),
        (lambda m: BadSampling(temperature=-1), "BadSampling.temperature=-1: must be a finite number >= 0 or null"),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call(make())


def test_published_size_has_the_published_number_of_parameters():
    """Compare with STATE_DICTS: 238.9 M and 236.2 M, less the table of positions that nothing reads."""
    for time_token, expected, rows in ((True, 238_891_648, 52), (False, 236_265_088, 51)):
        with torch.device("meta"):
            model = BAD(codebook_size=8192, code_dim=32, text_dim=512, token_dim=512, time_token=time_token)
        assert sum(p.numel() for p in model.parameters()) == expected - rows * 1024


def test_the_paper_s_schedule_takes_all_steps_for_every_length():
    lengths = torch.tensor([49, 12, 1])
    counts = paper_counts(lengths, 10)
    for i, row in enumerate(counts.tolist()):
        assert row == [max(1, round(n * math.cos(math.pi * i / 20))) for n in lengths.tolist()]
    steps = make().trajectory(text(), FRAMES, seeds=SEEDS, sampling=BadSampling(schedule="paper"))
    assert [masked.sum(dim=1).tolist() for masked, _, _ in steps] == paper_counts(LENGTHS, 10).tolist()
    with pytest.raises(ValueError, match=r"sampling.schedule 'paper' is not what the published samplers do"):
        BadSampling(schedule="paper", official_inference_mask=True)

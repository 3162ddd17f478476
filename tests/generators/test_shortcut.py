"""Test the shortcut of a flow: it starts as its teacher, learns what it should, and samples in few steps."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from kinema.diffusion.flow import Flow
from kinema.diffusion.grids import nested
from kinema.generators.frames.sampling import FrameSampling
from kinema.generators.msflow import MSFlow, Shortcut, ShortcutSampling
from kinema.generators.msflow.shortcut import ShortcutDraws
from kinema.nn import ranks
from kinema.types import Known, Latents, TextFeatures, frame_mask

LENGTHS = torch.tensor([12, 5, 9])
SEEDS = torch.tensor([11, 12, 13])
MOST = 14


def flow(**options) -> MSFlow:
    """Make a tiny generator whose layers all have an influence."""
    sizes = {"frame_dim": 6, "token_dim": 7, "width": 16, "feedforward": 24, "layers": 2, "heads": 2}
    torch.manual_seed(0)
    model = MSFlow(process=Flow(prediction="x1", source_scale=5.0), **(sizes | {"max_frames": MOST} | options))
    for parameter in model.parameters():
        torch.nn.init.normal_(parameter, std=0.25)
    return model.eval()


def make(*, started: bool = True, teacher: MSFlow | None = None, **options) -> Shortcut:
    """Make the shortcut of a generator; `started` gives its levels an influence."""
    trained = teacher or flow(null_tokens=2)
    kind = {"null_tokens": 2 if trained.denoiser.words.null is not None else 0, "patch": trained.denoiser.patch}
    model = Shortcut(generator=flow(**kind), **options)
    with torch.no_grad():
        for parameter in model.generator.parameters():
            parameter.add_(1.0)  # not the teacher's, before it learns from it
    model.learn_from(trained)
    if started:
        torch.nn.init.normal_(model.level.weight, generator=torch.Generator().manual_seed(3))
    return model.eval()


def attached(shortcut: Shortcut) -> MSFlow:
    generator = flow(null_tokens=2)
    generator.attach("shortcut", shortcut)
    return generator


def text(rows: list[int] | None = None) -> TextFeatures:
    generator = torch.Generator().manual_seed(1)
    tokens = torch.randn(4, 6, 7, generator=generator)
    rows = [0, 1, 2] if rows is None else rows
    counts = torch.tensor([6, 2, 4, 3])[rows]
    seen = frame_mask(counts, int(counts.max()))
    own = tokens[rows][:, : seen.shape[1]] * seen[..., None]
    return TextFeatures([str(i) for i in rows], own.mean(dim=1), own, seen)


def latents(lengths: torch.Tensor = LENGTHS) -> Latents:
    values = torch.randn(4, MOST, 6, generator=torch.Generator().manual_seed(2))[: len(lengths), : int(lengths.max())]
    return Latents(lengths, lengths, values=values * frame_mask(lengths, values.shape[1])[..., None])


def draws(taught: list[bool], level: float, interval: list[float]) -> ShortcutDraws:
    count = len(taught)
    noise = torch.randn(count, MOST, 6, generator=torch.Generator().manual_seed(5))
    return ShortcutDraws(torch.tensor(taught), torch.full((count,), level), torch.tensor(interval), noise)


def close(a: torch.Tensor, b: torch.Tensor) -> None:
    torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-4)


# Where it starts


@pytest.mark.parametrize("guidance", [1.0, 2.5])
def test_an_untrained_shortcut_lacks_the_guidance_alone(guidance):
    """At the finest level, with one substep, it is the teacher."""
    model = make(started=False, guidance=guidance, substeps=1)
    taught = draws([True] * 3, 0.0, [0.01, 0.5, 0.99]).crop(slice(None), 12)
    loss = model.loss(latents(), text(), draws=taught)["loss"]
    assert (loss < 1e-8) if guidance == 1 else (loss > 1e-2)


def test_an_untrained_shortcut_samples_as_the_generator_without_guidance():
    shortcut = make(started=False, finest=8, grid="emergence")
    generator = attached(shortcut)
    few = generator.sample(text(), LENGTHS, seeds=SEEDS, sampling=ShortcutSampling(steps=8))
    plain = FrameSampling(guidance=1.0, solver="euler", solver_steps=8, solver_grid="emergence")
    close(few.values, flow(null_tokens=2).sample(text(), LENGTHS, seeds=SEEDS, sampling=plain).values)


# What it learns


def expected(model: Shortcut, first: int, last: int, taught: bool) -> torch.Tensor:
    """Return the clean motion that a step over [first, last] of the grid should aim at, sample by sample, by hand."""
    batch, noise = latents(), draws([True] * 3, 0.0, [0.0] * 3).noise[:, :12]
    found = torch.zeros_like(batch.values)
    for i, length in enumerate(LENGTHS.tolist()):
        words, x1 = text([i]), batch.values[i : i + 1, :length]
        start, end = model.times[first], model.times[last]
        x = start * x1 + (1 - start) * 5.0 * noise[i : i + 1, :length]
        here = x
        for t, then, level in ways(model, first, last, taught):
            clean = predicted(model, here, words, t, level)
            here = here + (then - t) / (1 - t) * (clean - here)
        found[i, :length] = (x + (here - x) * (1 - start) / (end - start))[0]
    return found


def ways(model: Shortcut, first: int, last: int, taught: bool) -> list[tuple[float, float, int | None]]:
    """List the small steps: two of the teacher's in each of the finest (level None), or two of the level above."""
    if taught:
        ends = [
            (model.times[i], (model.times[i] + model.times[i + 1]) / 2, model.times[i + 1]) for i in range(first, last)
        ]
        return [pair for a, b, c in ends for pair in ((a, b, None), (b, c, None))]
    middle, level = model.times[(first + last) // 2], (last - first).bit_length() - 2
    return [(model.times[first], middle, level), (middle, model.times[last], level)]


def predicted(model: Shortcut, x: torch.Tensor, words: TextFeatures, t: float, level: int | None) -> torch.Tensor:
    time = torch.tensor([t])
    if level is not None:
        return model.predictor(words, torch.tensor([level]), None)(x, time)
    network = model.teacher.denoiser
    given, empty = (network(x, time, *network.read(one)) for one in (words, model.teacher.without_text(words)))
    return empty + model.guidance * (given - empty)


@pytest.mark.parametrize(
    ("level", "interval", "first", "last"),
    [(0, 0.0, 0, 1), (0, 0.99, 7, 8), (1, 0.3, 2, 4), (1, 0.99, 6, 8), (2, 0.6, 4, 8), (3, 0.4, 0, 8)],
)
@pytest.mark.parametrize("taught", [True, False])
def test_targets_are_the_teachers_way_or_two_steps_of_the_next_finer_level(level, interval, first, last, taught):
    model = make(guidance=2.5)
    drawn = draws([taught] * 3, level / 4 + 0.1, [interval] * 3).crop(slice(None), 12)
    start = torch.tensor(model.times[first]).expand(3)
    x = model.process.add_noise(latents().values, start, drawn.noise)
    clean = model.predictor(text(), torch.full((3,), level), latents().mask)(x, start)
    errors = (clean - expected(model, first, last, taught or level == 0)).square().mean(dim=2)
    alone = torch.stack([errors[i, :n].mean() for i, n in enumerate(LENGTHS.tolist())])
    loss = model.loss(latents(), text(), draws=drawn)["loss"]
    torch.testing.assert_close(loss, alone.mean(), rtol=1e-3, atol=1e-5)


def test_a_batch_of_both_kinds_is_each_by_itself():
    model = make()
    mixed = [(True, 0.2), (False, 0.7), (True, 0.9)]
    drawn = draws([one for one, _ in mixed], 0.5, [place for _, place in mixed])
    alone = []
    for i, length in enumerate(LENGTHS.tolist()):
        own = drawn.crop(slice(i, i + 1), length)
        part = Latents(LENGTHS[i : i + 1], LENGTHS[i : i + 1], values=latents().values[i : i + 1, :length])
        alone.append(model.loss(part, text([i]), draws=own)["loss"])
    close(model.loss(latents(), text(), draws=drawn.crop(slice(None), 12))["loss"], torch.stack(alone).mean())


def test_the_teacher_and_targets_get_no_gradient_and_all_else_does():
    model = make(teacher_share=0.5).train()
    drawn = draws([True, False, False], 0.9, [0.3, 0.2, 0.8]).crop(slice(None), 12)
    model.loss(latents(), text(), draws=drawn)["loss"].backward()
    assert all(p.grad is None for p in model.teacher.parameters())
    assert [n for n, p in model.named_parameters() if p.grad is None or not p.grad.any()] == []
    assert not model.level.weight.grad[1:3].any()  # of the level that the targets are made with
    assert not any(name.startswith("_teacher") for name in model.state_dict())


def test_all_levels_and_intervals_are_drawn():
    drawn = ShortcutDraws.draw(
        (4000, 1, 1), teacher_share=0.25, generator=torch.Generator().manual_seed(0), device=torch.device("cpu")
    )
    level, first, last = make(finest=4)._intervals(drawn)
    assert drawn.taught.float().mean() == pytest.approx(0.25, abs=0.03)
    assert (level == 0).float().mean() == pytest.approx(1 / 3, abs=0.03)
    found = set(zip(level.tolist(), first.tolist(), last.tolist(), strict=True))
    assert found == {(0, 0, 1), (0, 1, 2), (0, 2, 3), (0, 3, 4), (1, 0, 2), (1, 2, 4), (2, 0, 4)}


def test_the_levels_of_some_counts_alone_are_drawn_and_sampled():
    drawn = ShortcutDraws.draw(
        (400, 1, 1), teacher_share=1.0, generator=torch.Generator().manual_seed(0), device=torch.device("cpu")
    )
    model = make(finest=8, counts=[1, 4])
    level, first, last = model._intervals(drawn)
    found = set(zip(level.tolist(), first.tolist(), last.tolist(), strict=True))
    assert found == {(1, 0, 2), (1, 2, 4), (1, 4, 6), (1, 6, 8), (3, 0, 8)}
    assert model.sampling.steps == 1
    attached(model).check_sampling(ShortcutSampling(steps=4))
    with pytest.raises(ValueError, match=r"steps=2: this shortcut learns 1, 4; .* with counts=\[2\]"):
        attached(model).check_sampling(ShortcutSampling(steps=2))
    with pytest.raises(ValueError, match=r"3 steps are not of a grid of 8; halving it leaves 8, 4, 2, 1"):
        make(counts=[3])
    for counts in ([2], [8, 2]):
        with pytest.raises(ValueError, match=r"teacher_share=0\.5 .* must be 8 and all halves of it"):
            make(counts=counts, teacher_share=0.5)
    make(counts=[4, 8], teacher_share=0.5)


def test_padding_never_reaches_the_loss():
    model, clean = make(), latents()
    garbage = replace(clean, values=torch.where(clean.mask[..., None], clean.values, 1e6))
    wider = replace(clean, values=torch.cat((garbage.values, torch.full((3, 2, 6), 1e6)), dim=1))
    drawn = draws([True, False, True], 0.2, [0.1, 0.5, 0.9])
    losses = [
        model.loss(x, text(), draws=drawn.crop(slice(None), x.values.shape[1]))["loss"] for x in (clean, garbage, wider)
    ]
    assert torch.equal(losses[0], losses[1])
    close(losses[0], losses[2])


def test_ranks_average_to_the_loss_of_one_process(monkeypatch):
    model, batch = make(), latents(torch.tensor([12, 5, 9, 3]))

    def loss(rows: list[int], shard: tuple[int, int]) -> torch.Tensor:
        part = Latents(batch.lengths[rows], batch.frames[rows], batch.values[rows])
        return model.loss(part, text(rows), generator=torch.Generator().manual_seed(5), shard=shard)["loss"]

    whole = loss([0, 1, 2, 3], (0, 1))
    monkeypatch.setattr(ranks.distributed, "is_initialized", lambda: True)
    monkeypatch.setattr(ranks.distributed, "all_reduce", lambda rows: rows.fill_(4))
    close(torch.stack([loss([2 * rank, 2 * rank + 1], (rank, 2)) for rank in (0, 1)]).mean(), whole)


def test_it_learns_to_be_the_guided_teacher_in_fewer_steps():
    """Fit one sample's noise and text: one step then ends near where the guided teacher's sixteen do."""
    model = make(started=False, guidance=2.0, finest=2, grid="uniform", teacher=flow()).train()
    teacher = model.teacher
    noise = 5.0 * torch.randn(1, 6, 6, generator=torch.Generator().manual_seed(9))
    many = FrameSampling(guidance=2.0, solver="euler", solver_steps=4)
    goal = teacher.sample(
        text([0]), torch.tensor([6]), seeds=SEEDS[:1], sampling=many, noise=iter([noise / 5.0])
    ).values
    generator = flow()

    def error() -> float:
        generator.attach("shortcut", model.eval())
        made = generator.sample(
            text([0]), torch.tensor([6]), seeds=SEEDS[:1], sampling=ShortcutSampling(steps=1), noise=iter([noise / 5.0])
        )
        model.train()
        return (made.values - goal).square().mean().item()

    before, optimizer = error(), torch.optim.Adam(model.parameters(), lr=3e-3)
    batch = Latents(torch.tensor([6, 6, 6]), torch.tensor([6, 6, 6]), values=goal.expand(3, -1, -1))
    levels = torch.tensor([0.0, 0.0, 0.9])
    drawn = replace(
        draws([True, True, False], 0.0, [0.0, 0.9, 0.0]), level=levels, noise=(noise / 5.0).expand(3, -1, -1)
    )
    for _ in range(150):
        optimizer.zero_grad()
        model.loss(batch, text([0, 0, 0]), draws=drawn)["loss"].backward()
        optimizer.step()
    assert error() < 0.1 * before


# How it samples


@pytest.mark.parametrize("steps", [1, 2, 4, 8])
def test_a_step_is_one_evaluation_of_the_shortcut_without_guidance(steps):
    model = make()
    generator, calls = attached(model), []
    generator.networks["denoiser"].register_forward_pre_hook(lambda _, inputs: calls.append(inputs[:2]))
    generator.sample(text(), LENGTHS, seeds=SEEDS, sampling=ShortcutSampling(steps=steps))
    assert [len(x) for x, _ in calls] == [3] * steps
    assert [time.item() for _, time in calls] == pytest.approx(nested(model.times, steps)[:-1])


def test_levels_matter():
    generator = attached(make(finest=2))
    shortcut = generator.shortcut
    one = generator.sample(text(), LENGTHS, seeds=SEEDS, sampling=ShortcutSampling(steps=1)).values
    torch.nn.init.zeros_(shortcut.level.weight)
    other = generator.sample(text(), LENGTHS, seeds=SEEDS, sampling=ShortcutSampling(steps=1)).values
    assert not torch.allclose(one, other, atol=1e-2)


@pytest.mark.parametrize("steps", [1, 4])
def test_samples_do_not_depend_on_batch_order_or_padding(steps):
    generator = attached(make())
    few = ShortcutSampling(steps=steps)
    together = generator.sample(text(), LENGTHS, seeds=SEEDS, sampling=few)
    assert not together.values[~together.mask].any()
    for rows in ([1], [2, 1], [2, 0, 1]):
        some = generator.sample(text(rows), LENGTHS[rows], seeds=SEEDS[rows], sampling=few)
        for i, row in enumerate(rows):
            length = int(together.lengths[row])
            close(some.values[i, :length], together.values[row, :length])
    for other in (
        generator.sample(text(), LENGTHS, seeds=SEEDS + 10, sampling=few),
        generator.sample(text([2, 0, 1]), LENGTHS, seeds=SEEDS, sampling=few),
    ):
        assert (together.values[together.mask] - other.values[together.mask]).abs().max() > 1e-3


@pytest.mark.parametrize("holding", ["path", "projection"])
@pytest.mark.parametrize("steps", [1, 4])
def test_edits_keep_what_is_known_bit_by_bit(holding, steps):
    generator, source = attached(make()), latents()
    mask = torch.zeros_like(source.values, dtype=torch.bool)
    mask[:, :3], mask[:, :, 0] = True, True
    few = ShortcutSampling(steps=steps, holding=holding, renewal=0.5 if holding == "projection" else None)
    edited = generator.sample(text(), None, seeds=SEEDS, known=Known(source, mask), sampling=few)
    kept = mask & source.mask[..., None]
    assert torch.equal(edited.values[kept], source.values[kept])
    free = ~mask & source.mask[..., None]
    assert (edited.values - source.values)[free].abs().max() > 1e-2
    other = replace(source, values=torch.where(mask, source.values + 0.5, source.values))
    again = generator.sample(text(), None, seeds=SEEDS, known=Known(other, mask), sampling=few)
    assert torch.equal(again.values[free], edited.values[free]) == (steps == 1)  # one step knows noise alone


def test_from_the_attachment_on_it_is_the_default():
    generator = flow(null_tokens=2)
    own = generator.sampling
    generator.attach("shortcut", make(sampling=ShortcutSampling(steps=2)))
    assert (generator.sampling, type(own)) == (ShortcutSampling(steps=2), FrameSampling)
    few = generator.sample(text(), LENGTHS, seeds=SEEDS)
    assert torch.equal(few.values, generator.sample(text(), LENGTHS, seeds=SEEDS, sampling=generator.sampling).values)
    whole = generator.sample(text(), LENGTHS, seeds=SEEDS, sampling=own)
    assert torch.equal(whole.values, flow(null_tokens=2).sample(text(), LENGTHS, seeds=SEEDS).values)


# What is refused


def test_what_does_not_fit_is_named():
    with pytest.raises(ValueError, match=r"this model has none; give the run of its shortcut stage"):
        flow().check_sampling(ShortcutSampling())
    with pytest.raises(ValueError, match=r"this model has none"):
        flow().sample(text(), LENGTHS, seeds=SEEDS, sampling=ShortcutSampling())
    with pytest.raises(ValueError, match=r"8 steps are not of a grid of 4; halving it leaves 4, 2, 1"):
        attached(make(finest=4)).check_sampling(ShortcutSampling(steps=8))
    with pytest.raises(ValueError, match="has none; call learn_from"):
        Shortcut(generator=flow()).loss(latents(), text())
    with pytest.raises(ValueError, match=r"a MSFlow is no shortcut; give the run of a shortcut stage"):
        flow().attach("shortcut", flow())
    with pytest.raises(ValueError, match="takes no 'residual'; it takes shortcut"):
        flow().attach("residual", make())
    with pytest.raises(
        ValueError, match=r"denoiser\.\S+ is \(16,\) in the generator and \(8,\) in its shortcut; train"
    ):
        flow(width=32, null_tokens=2).attach("shortcut", make())
    other = MSFlow(process=Flow(prediction="x1"), frame_dim=6, token_dim=7, width=16, heads=2)
    with pytest.raises(ValueError, match=r"of prediction x1 and source_scale 5\.0, the generator's is another"):
        other.attach("shortcut", make())
    with pytest.raises(ValueError, match="must be a Flow with prediction x1"):
        Shortcut(generator=MSFlow(process=Flow(), frame_dim=6, token_dim=7, width=16, heads=2))
    with pytest.raises(ValueError, match="no empty text to be guided from; use guidance=1"):
        Shortcut(generator=flow(condition_drop=0.0, sampling=FrameSampling()))
    with pytest.raises(ValueError, match=r"finest=6"):
        Shortcut(generator=flow(), finest=6)

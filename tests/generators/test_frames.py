"""Test diffusion on frames (MDM, MotionDiffuse, MSFlow): loss, generation, edits and invariances."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from kinema.diffusion.ddpm import DDPM
from kinema.diffusion.flow import Flow
from kinema.generators.frames.sampling import FrameSampling
from kinema.generators.frames.training import FrameDraws
from kinema.generators.mdm import MDM
from kinema.generators.motiondiffuse import MotionDiffuse
from kinema.generators.msflow import MSFlow
from kinema.nn import ranks
from kinema.types import Known, Latents, TextFeatures, frame_mask

LENGTHS = torch.tensor([12, 5, 9])
PASS = int(LENGTHS.sum()) + 3  # rows through a block: no padding, and a condition a sample
SEEDS = torch.tensor([11, 12, 13])
MOST = 14
SMALL = {"frame_dim": 6, "width": 16, "feedforward": 24, "layers": 2, "heads": 2, "dropout": 0.3, "max_frames": MOST}
DECODER = {"architecture": "decoder", "text_dim": None, "token_dim": 7}
WORDS = {"token_dim": 7, "text_width": 8, "text_feedforward": 10, "text_layers": 1, "text_heads": 2}


def mdm(process=None, **options) -> MDM:
    return MDM(process=process or DDPM(steps=6, prediction="x0"), **(SMALL | {"text_dim": 5} | options))


def motiondiffuse(**options) -> MotionDiffuse:
    return MotionDiffuse(process=DDPM(steps=6), **(SMALL | WORDS | options))


def msflow(**options) -> MSFlow:
    sizes = {name: value for name, value in SMALL.items() if name != "dropout"}
    few = {"token_dim": 7, "sampling": FrameSampling(guidance=2.5, solver="heun", solver_steps=4)}
    return MSFlow(process=Flow(prediction="x1", source_scale=5.0), **(sizes | few | options))


GROUPED = {"patch": 4, "mask": "causal", "mask_block": 2, "null_tokens": 2, "shared_modulation": True}

MODELS = {
    "mdm": mdm,
    "epsilon": lambda **options: mdm(DDPM(steps=6), **options),
    "flow": lambda **options: mdm(Flow(), **options),
    "unmasked": lambda **options: mdm(mask_frames=False, **options),
    "decoder": lambda **options: mdm(**(DECODER | options)),
    "motiondiffuse": motiondiffuse,
    "words_as_they_are": lambda **options: motiondiffuse(text_layers=0, **options),
    "msflow": msflow,
    "msflow_groups": lambda **options: msflow(**(GROUPED | options)),
    "msflow_cross": lambda **options: msflow(text_attention="cross", refiner_layers=0, **options),
    "msflow_once": lambda **options: msflow(text_attention="cross", refiner_timed=False, null_tokens=2, **options),
    "softmax": lambda **options: motiondiffuse(attention="softmax", **options),
}


def make(name: str = "mdm", **options):
    """Make a tiny model whose layers all have an influence."""
    torch.manual_seed(0)
    model = MODELS[name](**options)
    for parameter in model.parameters():
        torch.nn.init.normal_(parameter, std=0.25)
    return model.eval()


def text(rows: list[int] | None = None) -> TextFeatures:
    generator = torch.Generator().manual_seed(1)
    pooled, tokens = torch.randn(4, 5, generator=generator), torch.randn(4, 6, 7, generator=generator)
    rows = [0, 1, 2] if rows is None else rows
    counts = torch.tensor([6, 2, 4, 3])[rows]
    seen = frame_mask(counts, int(counts.max()))
    own = tokens[rows][:, : seen.shape[1]] * seen[..., None]
    return TextFeatures([str(i) for i in rows], pooled[rows], own, seen)


def latents(lengths: torch.Tensor = LENGTHS) -> Latents:
    values = torch.randn(4, MOST, 6, generator=torch.Generator().manual_seed(2))[: len(lengths), : int(lengths.max())]
    return Latents(lengths, lengths, values=values * frame_mask(lengths, values.shape[1])[..., None])


def draws(model, samples: int = 3, seed: int = 0) -> FrameDraws:
    return FrameDraws.draw(
        (samples, MOST, 6),
        model.process,
        condition_drop=0.3,
        generator=torch.Generator().manual_seed(seed),
        device=torch.device("cpu"),
    )


def close(a: torch.Tensor, b: torch.Tensor) -> None:
    torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-4)


# Training


@pytest.mark.parametrize("name", MODELS)
def test_every_parameter_learns(name):
    model = make(name).train()
    model.loss(latents(), text(), generator=torch.Generator().manual_seed(0))["loss"].backward()
    assert [n for n, p in model.named_parameters() if p.grad is None or not p.grad.any()] == []


def test_the_loss_is_a_function_of_the_generator():
    model = make()
    first, again, other = (
        model.loss(latents(), text(), generator=torch.Generator().manual_seed(seed))["loss"] for seed in (3, 3, 4)
    )
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


@pytest.mark.parametrize("name", MODELS)
def test_padding_never_reaches_the_loss(name):
    """Give garbage in the padding, and more padding."""
    model, clean = make(name), latents()
    garbage = replace(clean, values=torch.where(clean.mask[..., None], clean.values, 1e6))
    wider = replace(clean, values=torch.cat((garbage.values, torch.full((3, 2, 6), 1e6)), dim=1))
    losses = [
        model.loss(x, text(), draws=draws(model).crop(slice(None), MOST if name == "unmasked" else x.values.shape[1]))
        for x in (clean, garbage, wider)
    ]
    assert torch.equal(losses[0]["loss"], losses[1]["loss"])
    close(losses[0]["loss"], losses[2]["loss"])


@pytest.mark.parametrize("name", ["mdm", "motiondiffuse"])
def test_frames_count_alike_or_samples_do(name):
    """MDM averages over each sample's frames first, MotionDiffuse over all frames (MDM §3)."""
    model, batch = make(name), latents()
    drawn = draws(model).crop(slice(None), 12)
    errors = model.errors(batch.values, text(), drawn, batch.mask).mean(dim=2)
    alone = torch.stack([errors[i, :n].mean() for i, n in enumerate(LENGTHS.tolist())])
    expected = alone.mean() if name == "mdm" else (alone * LENGTHS).sum() / LENGTHS.sum()
    close(model.loss(batch, text(), draws=drawn)["loss"], expected)


@pytest.mark.parametrize("name", ["mdm", "motiondiffuse"])
def test_ranks_average_to_the_loss_of_one_process(monkeypatch, name):
    """Let two ranks of different numbers of frames share them as a process group does."""
    model, batch = make(name), latents(torch.tensor([12, 5, 9, 3]))

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
    close(torch.stack(both).mean(), whole)


@pytest.mark.parametrize("name", ["mdm", "decoder"])
def test_the_text_is_dropped_in_training_only(name):
    model, batch = make(name, condition_drop=1.0, dropout=0.0), latents()
    other = replace(text(), pooled=torch.randn(3, 5), tokens=torch.randn(3, 6, 7))

    def losses() -> list[torch.Tensor]:
        return [model.loss(batch, t, generator=torch.Generator().manual_seed(0))["loss"] for t in (text(), other)]

    assert not torch.equal(*losses())
    model.train()
    assert torch.equal(*losses())


# Generation


@pytest.mark.parametrize("name", MODELS)
def test_samples_do_not_depend_on_batch_order_or_padding(name):
    model = make(name)
    together = model.sample(text(), LENGTHS, seeds=SEEDS)
    for rows in ([1], [2, 1], [2, 0, 1]):
        some = model.sample(text(rows), LENGTHS[rows], seeds=SEEDS[rows])
        for i, row in enumerate(rows):
            length = int(together.lengths[row])
            close(some.values[i, :length], together.values[row, :length])


@pytest.mark.parametrize("name", MODELS)
def test_seed_and_text_matter_and_padding_is_zero(name):
    model = make(name)
    base = model.sample(text(), LENGTHS, seeds=SEEDS)
    assert base.lengths.tolist() == base.frames.tolist() == LENGTHS.tolist()
    assert base.values.shape == (3, 12, 6)
    assert not base.values[~base.mask].any()
    assert torch.equal(base.values, model.sample(text(), LENGTHS, seeds=SEEDS).values)
    for other in (
        model.sample(text(), LENGTHS, seeds=SEEDS + 10),
        model.sample(text([2, 0, 1]), LENGTHS, seeds=SEEDS),
    ):
        assert (base.values[base.mask] - other.values[base.mask]).abs().max() > 1e-3


def test_without_a_mask_a_motion_is_the_start_of_the_longest():
    """A shorter motion of the same seed and text is the beginning of a longer one (MDM §2)."""
    model = make("unmasked")
    long, short = (model.sample(text(), n, seeds=SEEDS).values for n in (LENGTHS, LENGTHS - 3))
    for i, length in enumerate((LENGTHS - 3).tolist()):
        close(short[i, :length], long[i, :length])


def test_guidance_extrapolates_from_no_text():
    model, other = make(), text([2, 0, 1])
    made = {
        scale: model.sample(text(), LENGTHS, seeds=SEEDS, sampling=FrameSampling(guidance=scale)).values
        for scale in (0.0, 1.0, 1.00001, 5.0)
    }
    without = model.sample(other, LENGTHS, seeds=SEEDS, sampling=FrameSampling(guidance=0.0)).values
    close(without, made[0.0])
    close(made[1.0], made[1.00001])
    assert not torch.allclose(made[1.0], made[5.0], atol=1e-3)


def test_guidance_may_act_on_a_part_of_the_way():
    model, rows = make(), []
    model.denoiser.blocks[0].register_forward_hook(lambda module, inputs, output: rows.append(len(output)))
    late = FrameSampling(guidance=5.0, guidance_interval=(0.5, 1.0))
    made = model.sample(text(), LENGTHS, seeds=SEEDS, sampling=late).values
    assert rows == [PASS] * 3 + [2 * PASS] * 3
    whole = model.sample(text(), LENGTHS, seeds=SEEDS, sampling=FrameSampling(guidance=5.0)).values
    growing = replace(late, guidance_interval=(0.0, 1.0), guidance_growing=True)
    grown = model.sample(text(), LENGTHS, seeds=SEEDS, sampling=growing).values
    assert not torch.equal(made, whole)
    assert not torch.equal(made, grown)


def test_guidance_costs_a_second_pass_in_the_same_batch():
    model, rows = make(), []
    model.denoiser.blocks[0].register_forward_hook(lambda module, inputs, output: rows.append(len(output)))
    model.sample(text(), LENGTHS, seeds=SEEDS)
    assert rows == [2 * PASS] * 6
    rows.clear()
    model.sample(text(), LENGTHS, seeds=SEEDS, sampling=FrameSampling(guidance=1.0, solver_steps=3))
    assert rows == [PASS] * 3


@pytest.mark.parametrize(
    ("name", "solver"),
    [("mdm", "ddim"), ("mdm", "dpmpp_2m"), ("epsilon", "heun"), ("motiondiffuse", "ddim"), ("flow", "heun")],
)
def test_other_solvers(name, solver):
    made = make(name).sample(text(), LENGTHS, seeds=SEEDS, sampling=FrameSampling(solver=solver, solver_steps=3))
    assert made.values.isfinite().all()


def test_training_mode_is_left_alone_and_has_no_dropout_in_samples():
    model = make()
    expected = model.sample(text(), LENGTHS, seeds=SEEDS).values
    model.train()
    made = model.sample(text(), LENGTHS, seeds=SEEDS).values
    assert torch.equal(made, expected)
    assert model.denoiser.training
    assert not made.requires_grad


# Editing


def inbetween() -> torch.Tensor:
    keep = frame_mask(LENGTHS, 12)
    keep[:, 2:4] = False
    return keep


def columns() -> torch.Tensor:
    return frame_mask(LENGTHS, 12)[..., None] & (torch.arange(6) < 2)


MASKS = {"frames": inbetween, "features": columns}


@pytest.mark.parametrize("mask", MASKS)
@pytest.mark.parametrize("name", MODELS)
def test_an_edit_keeps_bits_and_regenerates_the_rest(name, mask):
    keep, source = MASKS[mask](), latents()
    made = make(name).sample(text(), None, seeds=SEEDS, known=Known(source, keep))
    kept = (keep if keep.ndim == 3 else keep[..., None]).expand_as(source.values)
    free = ~kept & source.mask[..., None]
    assert torch.equal(made.values[kept], source.values[kept])
    assert (made.values[free] != source.values[free]).all()
    assert torch.equal(made.lengths, source.lengths)
    assert made.values.isfinite().all()


@pytest.mark.parametrize("name", ["mdm", "epsilon", "flow", "motiondiffuse"])
def test_what_is_kept_reaches_what_is_free_and_nothing_else_of_the_source_does(name):
    model, keep, source = make(name), columns(), latents()
    free = replace(source, values=torch.where(keep, source.values, 100.0))
    moved = replace(source, values=torch.where(keep, source.values + 1, source.values))
    base, same, other = (
        model.sample(text(), None, seeds=SEEDS, known=Known(x, keep)).values for x in (source, free, moved)
    )
    assert torch.equal(base, same)
    assert not torch.allclose(base[..., 2:], other[..., 2:], atol=1e-3)


@pytest.mark.parametrize("name", MODELS)
def test_nothing_known_is_generation(name):
    model, nothing = make(name), torch.zeros(3, 12, dtype=torch.bool)
    edited = model.sample(text(), None, seeds=SEEDS, known=Known(latents(), nothing)).values
    assert torch.equal(edited, model.sample(text(), LENGTHS, seeds=SEEDS).values)


# Errors


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda m: m.sample(text(), torch.tensor([0, 5, 5]), seeds=SEEDS), "cannot generate 0 frames; give 1 to 14"),
        (lambda m: m.sample(text(), torch.tensor([5, 15, 5]), seeds=SEEDS), "cannot generate 15 frames"),
        (lambda m: m.sample(text(), None, seeds=SEEDS), "LengthEstimator"),
        (lambda m: m.sample(text([0, 1]), LENGTHS, seeds=SEEDS), "3 lengths, 2 texts and 3 seeds"),
        (lambda m: m.sample(text(), LENGTHS - 1, seeds=SEEDS, known=Known(latents(), inbetween())), "frames=None"),
        (
            lambda m: m.sample(text(), None, seeds=SEEDS, known=Known(latents(), columns()[..., :3])),
            "one mask entry per position, or per position and feature",
        ),
        (
            lambda m: m.loss(Latents(LENGTHS, LENGTHS, codes=torch.zeros(3, 12, 1, dtype=torch.long)), text()),
            "6 channels .frame_dim., not for codes",
        ),
        (lambda m: m.loss(replace(latents(), values=torch.zeros(3, 15, 6)), text()), "15 frames exceed max_frames=14"),
        (lambda m: FrameSampling(guidance_interval=(0.5, 0.5)), "give .start, end. with 0 <= start < end <= 1"),
        (lambda m: make(architecture="gru"), "MDM.architecture=gru: must be one of encoder, decoder"),
        (lambda m: make(token_dim=7), "give one of the two"),
        (lambda m: make(heads=3), "heads 3"),
        (
            lambda m: make("motiondiffuse", attention="full"),
            "attention=full: must be one of linear, softmax",
        ),
        (lambda m: make("motiondiffuse", sampling=FrameSampling(guidance=2.0)), "use guidance=1"),
        (lambda m: make("flow", sampling=FrameSampling(solver="ddim")), "'ddim' is unknown to Flow"),
        (lambda m: make("decoder").loss(latents(), replace(text(), tokens=None)), "attends to tokens"),
        (lambda m: make("motiondiffuse").loss(latents(), replace(text(), tokens=None)), "attends to tokens"),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call(make())


# Networks


def test_layers_start_alike_as_torch_s_do():
    """MDM §2: torch clones one layer, so that all start with the same weights."""
    torch.manual_seed(0)
    model = mdm(layers=3, width=64)
    first, *others = model.denoiser.blocks
    for block in others:
        for ours, theirs in zip(block.parameters(), first.parameters(), strict=True):
            assert torch.equal(ours, theirs)
    torch.manual_seed(0)
    layer = torch.nn.TransformerEncoderLayer(64, 2, 24)
    spread = layer.self_attn.in_proj_weight.std().item()
    assert first.attention.query.weight.std().item() == pytest.approx(spread, rel=0.05)
    assert not first.attention.key.bias.any()
    assert not first.attention.proj.bias.any()


def test_an_untrained_motiondiffuse_predicts_no_noise():
    torch.manual_seed(0)
    model = motiondiffuse()
    x = torch.randn(3, 12, 6)
    assert not model.denoiser(x, torch.tensor([1, 2, 3]), *model.denoiser.read(text())).any()
    assert not any(block.cross.style.output.weight.any() for block in model.denoiser.blocks)


def differ(first: Latents, second: Latents) -> bool:
    return (first.values - second.values).abs().max().item() > 1e-3


def test_the_temperature_reaches_the_process():
    made = [
        make("epsilon").sample(text(), LENGTHS, seeds=SEEDS, sampling=FrameSampling(temperature=warm))
        for warm in (0.0, 1.0)
    ]
    assert differ(*made)


def test_the_renewal_reaches_the_process():
    known = Known(latents(), inbetween())
    made = [
        make("msflow").sample(
            text(),
            None,
            seeds=SEEDS,
            known=known,
            sampling=FrameSampling(solver_steps=6, holding="projection", renewal=share),
        )
        for share in (0.0, 0.9)
    ]
    assert differ(*made)

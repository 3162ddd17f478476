"""Test MoMask's residual transformer: which layer sees what, training loss, completion, kept codes and errors."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from kinema.generators.bamm import BAMM, BammSampling
from kinema.generators.gpt import T2MGPT, GptSampling
from kinema.generators.momask import MoMask, MoMaskSampling
from kinema.generators.tokens.residual import ResidualDraws, ResidualSampling, ResidualTransformer, drawn_layer
from kinema.nn import ranks
from kinema.types import Known, Latents, TextFeatures

CODES, LAYERS = 30, 4
FRAMES = torch.tensor([48, 20, 36])
SEEDS = torch.tensor([11, 12, 13])
SAMPLING = ResidualSampling(guidance=2.5, top_k=0.5)
SHARING = (True, False)


def make(share_weights: bool = True, **options) -> ResidualTransformer:
    """Make a tiny model whose weights are large enough that everything has an influence."""
    torch.manual_seed(0)
    sizes = {"width": 16, "feedforward": 24, "layers": 2, "heads": 2, "dropout": 0.3, "max_latents": 12}
    model = ResidualTransformer(
        codebook_size=CODES,
        code_dim=6,
        text_dim=5,
        quantizers=LAYERS,
        share_weights=share_weights,
        sampling=SAMPLING,
        **(sizes | options),
    )
    for parameter in model.parameters():
        if parameter.ndim > 1:
            torch.nn.init.normal_(parameter, std=0.4)
    return model.eval()


def text(rows: list[int] | None = None) -> TextFeatures:
    pooled = torch.randn(4, 5, generator=torch.Generator().manual_seed(1))
    rows = [0, 1, 2] if rows is None else rows
    return TextFeatures([str(i) for i in rows], pooled[rows])


def latents(frames: torch.Tensor = FRAMES, quantizers: int = LAYERS) -> Latents:
    lengths = frames // 4
    codes = torch.randint(CODES, (4, 12, LAYERS), generator=torch.Generator().manual_seed(2))
    return Latents(lengths, frames, codes=codes[: len(frames), : int(lengths.max()), :quantizers])


def some(batch: Latents, rows: list[int]) -> Latents:
    return Latents(batch.lengths[rows], batch.frames[rows], codes=batch.codes[rows])


def draws(layer: list[float]) -> ResidualDraws:
    return ResidualDraws(torch.tensor(layer), torch.zeros(len(layer), dtype=torch.bool))


def close(a: torch.Tensor, b: torch.Tensor) -> None:
    torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-5)


# Training


@pytest.mark.parametrize("share_weights", SHARING)
def test_every_parameter_learns(share_weights):
    """Let the batch draw all layers (1, 2, 2, 3)."""
    model = make(share_weights).train()
    batch = latents(torch.tensor([48, 20, 36, 8]))
    model.loss(batch, text([0, 1, 2, 3]), draws=draws([0.1, 0.5, 0.6, 0.99]))["loss"].backward()
    for name, parameter in model.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.any(), name
        if "table" in name:
            assert parameter.grad.flatten(1).any(dim=1).all(), name


def test_layers_are_drawn_as_published():
    """Compare with .32, .25, .18, .17, .08 for six layers (MoMask §3)."""
    layer = drawn_layer(torch.rand(40_000, generator=torch.Generator().manual_seed(0)), 6)
    shares = (torch.bincount(layer, minlength=6) / 40_000).tolist()
    assert shares == pytest.approx([0, 0.32, 0.25, 0.18, 0.17, 0.08], abs=0.015)
    assert drawn_layer(torch.tensor([0.0, 0.999]), 2).tolist() == [1, 1]


def test_a_layer_sees_the_layers_below_only():
    """Change one layer's codes: bit-equal logits up to that layer, others above it."""
    model, batch = make(), latents()
    for changed in range(LAYERS):
        codes = batch.codes.clone()
        codes[..., changed] = (codes[..., changed] + 1) % CODES
        for q in range(1, LAYERS):
            layer = torch.full((3,), q)
            first, second = (
                model(model.history(c, layer), text().pooled, layer, batch.mask)[batch.mask]
                for c in (batch.codes, codes)
            )
            assert torch.equal(first, second) == (changed >= q)


@pytest.mark.parametrize("share_weights", SHARING)
def test_layers_of_a_batch_do_not_mix(share_weights):
    model, batch, layer = make(share_weights), latents(), torch.tensor([3, 1, 2])
    together = model(model.history(batch.codes, layer), text().pooled, layer, batch.mask)
    for row in range(3):
        one = slice(row, row + 1)
        history = model.history(batch.codes[one], layer[one])
        close(model(history, text().pooled[one], layer[one], batch.mask[one]), together[one])


def test_padding_never_reaches_the_loss():
    model, drawn = make(), draws([0.1, 0.5, 0.99])
    clean = latents(torch.tensor([20, 20, 36]))
    garbage = replace(clean, codes=torch.where(clean.mask[..., None], clean.codes, 999))
    wider = replace(clean, codes=torch.nn.functional.pad(garbage.codes, (0, 0, 0, 3), value=7))
    losses = [model.loss(x, text(), draws=drawn)["loss"] for x in (clean, garbage, wider)]
    assert torch.equal(losses[0], losses[1])
    close(losses[0], losses[2])


def test_ranks_average_to_the_loss_of_one_process(monkeypatch):
    model, batch = make(), latents(torch.tensor([48, 20, 36, 8]))
    total = int(batch.lengths.sum())

    def losses(rows: list[int], shard: tuple[int, int]) -> torch.Tensor:
        part = some(batch, rows)
        found = model.loss(part, text(rows), generator=torch.Generator().manual_seed(5), shard=shard)
        return torch.stack((found["loss"], found["accuracy"]))

    whole = losses([0, 1, 2, 3], (0, 1))
    monkeypatch.setattr(ranks.distributed, "is_initialized", lambda: True)
    monkeypatch.setattr(ranks.distributed, "all_reduce", lambda rows: rows.fill_(total))
    close(torch.stack([losses([2 * rank, 2 * rank + 1], (rank, 2)) for rank in (0, 1)]).mean(dim=0), whole)


def test_condition_is_dropped_in_training_only():
    drop_all, batch = make(condition_drop=1.0, dropout=0.0), latents()

    def losses() -> list[torch.Tensor]:
        return [
            drop_all.loss(batch, t, generator=torch.Generator().manual_seed(0))["loss"]
            for t in (text(), text([3, 2, 1]))
        ]

    assert not torch.equal(*losses())
    drop_all.train()
    assert torch.equal(*losses())


# Completion


@pytest.mark.parametrize("padding", [True, False])
@pytest.mark.parametrize("share_weights", SHARING)
def test_completion_keeps_the_base_and_zeroes_padding(share_weights, padding):
    base = latents(quantizers=1)
    own = ResidualSampling(padding=padding)
    result = make(share_weights).complete(base, text(), seeds=SEEDS, sampling=own)
    assert result.codes.shape == (3, 12, LAYERS)
    assert torch.equal(result.codes[..., :1][base.mask], base.codes[base.mask])
    assert not result.codes[~base.mask].any()
    assert result.codes.min() == (-1 if padding else 0)  # -1: a layer that adds nothing, drawn as published
    assert result.codes.max() < CODES
    assert torch.equal(result.lengths, base.lengths)
    assert torch.equal(result.frames, base.frames)


def test_samples_do_not_depend_on_batch_order_or_padding():
    model, base = make(), latents(quantizers=1)
    together = model.complete(base, text(), seeds=SEEDS).codes
    for rows in ([1], [2, 1], [2, 0, 1]):
        part = some(base, rows)
        part.codes = part.codes[:, : int(part.lengths.max())]
        found = model.complete(part, text(rows), seeds=SEEDS[rows]).codes
        for i, row in enumerate(rows):
            length = int(base.lengths[row])
            assert torch.equal(found[i, :length], together[row, :length])


def test_seed_text_and_options_matter():
    model, base = make(), latents(quantizers=1)
    first = model.complete(base, text(), seeds=SEEDS).codes
    for other in (
        model.complete(base, text(), seeds=SEEDS + 10),
        model.complete(base, text([2, 0, 1]), seeds=SEEDS),
        model.complete(base, text(), seeds=SEEDS, sampling=replace(SAMPLING, guidance=1.0)),
        model.complete(base, text(), seeds=SEEDS, sampling=replace(SAMPLING, temperature=0)),
    ):
        assert not torch.equal(first, other.codes)


def test_one_pass_per_layer():
    model, rows = make(), []
    model.encoder.blocks[0].register_forward_hook(lambda module, inputs, output: rows.append(len(output)))
    model.complete(latents(quantizers=1), text(), seeds=SEEDS)
    assert rows == [2 * (int(FRAMES.sum()) // 4 + 3 * 2)] * (LAYERS - 1)  # both passes: tokens, text and layer


def test_the_padding_class_is_never_drawn():
    model = make(share_weights=False)
    with torch.no_grad():
        model.score_bias[:, CODES] = 1e6
    result = model.complete(latents(quantizers=1), text(), seeds=SEEDS, sampling=replace(SAMPLING, temperature=0))
    assert result.codes.max() < CODES


def test_the_padding_class_adds_nothing_where_it_may_be_drawn():
    model = make(share_weights=False)
    with torch.no_grad():
        model.score_bias[1, CODES] = 1e6  # layer 2's
    base, own = latents(quantizers=1), ResidualSampling(temperature=0, padding=True)
    result = model.complete(base, text(), seeds=SEEDS, sampling=own)
    real = result.mask
    assert (result.codes[real][:, 2] == -1).all()
    assert (result.codes[real][:, [0, 1, 3]] >= 0).all()
    keep = real.clone()
    keep[:, 3:] = False
    again = model.complete(base, text(), seeds=SEEDS, known=Known(result, keep), sampling=own)
    assert torch.equal(again.codes, result.codes)  # what was drawn can be kept


def test_kept_positions_keep_every_layer():
    """Where the published code draws them anew, so that frames outside an edit drift."""
    source, model = latents(), make()
    keep = torch.rand(3, 14, generator=torch.Generator().manual_seed(3)) < 0.5
    longer = replace(source, codes=torch.nn.functional.pad(source.codes, (0, 0, 0, 2)))
    base = replace(source, codes=source.codes[..., :1])
    result = model.complete(base, text(), seeds=SEEDS, known=Known(longer, keep)).codes
    free = model.complete(base, text(), seeds=SEEDS).codes
    kept = keep[:, :12] & source.mask
    assert torch.equal(result[kept], source.codes[kept])
    assert not torch.equal(free[kept], source.codes[kept])
    nothing = model.complete(base, text(), seeds=SEEDS, known=Known(longer, torch.zeros_like(keep))).codes
    assert torch.equal(nothing, free)


def test_free_positions_of_the_source_do_not_leak():
    keep = torch.zeros(3, 12, dtype=torch.bool)
    keep[:, ::2] = True
    model, source, base = make(), latents(), latents(quantizers=1)
    changed = replace(source, codes=torch.where(keep[..., None], source.codes, 0))
    results = [model.complete(base, text(), seeds=SEEDS, known=Known(x, keep)).codes for x in (source, changed)]
    assert torch.equal(results[0], results[1])


# Options and errors


def test_options_come_from_the_base_generator():
    sizes = {"codebook_size": CODES, "text_dim": 5, "width": 16, "layers": 1, "heads": 2}
    options = {"residual_guidance": 6.0, "residual_temperature": 0.5, "residual_top_k": 0.0, "residual_padding": False}
    for base, sampling in ((MoMask(code_dim=6, **sizes), MoMaskSampling), (BAMM(code_dim=6, **sizes), BammSampling)):
        assert base.residual_sampling(sampling(**options)) == ResidualSampling(6.0, 0.5, 0.0, False)
    assert T2MGPT(**sizes).residual_sampling(GptSampling()) == ResidualSampling()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda m: m.loss(latents(quantizers=2), text()), "built for 4 codes per position, the tokenizer gives 2"),
        (
            lambda m: m.complete(
                latents(), text(), seeds=SEEDS, known=Known(latents(quantizers=1), torch.ones(3, 12, dtype=torch.bool))
            ),
            "built for 4 codes per position",
        ),
        (lambda m: m.complete(replace(latents(), codes=latents().codes + CODES), text(), seeds=SEEDS), "out of range"),
        (
            lambda m: ResidualTransformer(codebook_size=8, code_dim=6, text_dim=5, quantizers=1),
            "ResidualTransformer.quantizers=1: must be a whole number from 2",
        ),
        (lambda m: ResidualSampling(temperature=-1), "ResidualSampling.temperature=-1: must be a finite number >= 0"),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call(make())


@pytest.mark.parametrize(("share_weights", "size"), [(True, 13_364_224), (False, 14_417_413)])
def test_published_size_has_the_published_number_of_parameters(share_weights, size):
    """The published file of separate tables holds one row of 513 biases more, which no layer uses."""
    with torch.device("meta"):
        model = ResidualTransformer(
            codebook_size=512, code_dim=512, text_dim=512, quantizers=6, share_weights=share_weights
        )
    assert sum(p.numel() for p in model.parameters()) == size

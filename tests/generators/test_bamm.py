"""Test BAMM: its mask, training loss, both iterations, lengths by END, edits, invariances and errors."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import pytest
import torch

from kinema.decoding.draws import Greedy, SeededDraws
from kinema.generators.bamm.model import BAMM, BammSampling, condition_mask
from kinema.generators.bamm.sampling import CachedRows
from kinema.generators.bamm.training import BammDraws
from kinema.generators.tokens.residual import ResidualTransformer
from kinema.nn import ranks
from kinema.types import Known, Latents, TextFeatures, frame_mask

CODES, SLOTS = 11, 13
FRAMES = torch.tensor([48, 20, 36])
SEEDS = torch.tensor([11, 12, 13])
SAMPLING = BammSampling(guidance=2.5, second_guidance=2.0)


def make(norm: str = "post", **options) -> BAMM:
    """Make a tiny model whose weights are large enough that everything has an influence."""
    torch.manual_seed(0)
    sizes = {"width": 16, "feedforward": 24, "layers": 2, "heads": 2, "dropout": 0.3}
    model = BAMM(
        codebook_size=CODES, code_dim=6, text_dim=5, norm=norm, max_latents=12, sampling=SAMPLING, **(sizes | options)
    )
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.add_(torch.randn_like(parameter) * (0.5 if parameter.ndim > 1 else 0.1))
    return model.eval()


def text(rows: list[int] | None = None) -> TextFeatures:
    pooled = torch.randn(4, 5, generator=torch.Generator().manual_seed(1))
    rows = [0, 1, 2] if rows is None else rows
    return TextFeatures([str(i) for i in rows], pooled[rows])


def latents(frames: torch.Tensor = FRAMES) -> Latents:
    lengths = frames // 4
    codes = torch.randint(CODES, (4, 12, 1), generator=torch.Generator().manual_seed(2))
    return Latents(lengths=lengths, frames=frames, codes=codes[: len(frames), : int(lengths.max())])


def draws(samples: int = 3, seed: int = 0, shape: tuple[int, int] | None = None, **options) -> BammDraws:
    return BammDraws.draw(
        shape or (samples, SLOTS),
        **({"codebook_size": CODES, "condition_drop": 0.1, "corrupt": True} | options),
        generator=torch.Generator().manual_seed(seed),
        device=torch.device("cpu"),
    )


def close(a: torch.Tensor, b: torch.Tensor) -> None:
    torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-5)


def some(rate: float, size: int = 12, seed: int = 3) -> torch.Tensor:
    return torch.rand(3, size, generator=torch.Generator().manual_seed(seed)) < rate


# The mask


@pytest.mark.parametrize("slots", range(6))
def test_mask_is_the_definition(slots):
    """Compare every choice of conditions with BAMM's rule, the text at position 0 being one."""
    for chosen in itertools.product([False, True], repeat=slots):
        condition = [True, *chosen]
        expected = [[condition[k] or (not condition[q] and k <= q) for k in range(slots + 1)] for q in range(slots + 1)]
        mask = condition_mask(torch.tensor([chosen], dtype=torch.bool).view(1, slots))
        assert mask[0].tolist() == expected


def test_mask_of_the_published_example():
    rows = condition_mask(torch.tensor([[False, False, True, False, True]]))[0].int().tolist()
    assert ["".join(map(str, row)) for row in rows] == ["100101", "110101", "111101", "100101", "111111", "100101"]


@pytest.mark.parametrize("norm", ["pre", "post"])
def test_a_slot_reaches_only_the_rows_that_see_it(norm):
    """Change one slot: rows that may not see it, nor any row that did, stay bit-equal; some that may do change."""
    model, ids = make(norm), torch.randint(CODES, (1, 6), generator=torch.Generator().manual_seed(0))
    condition = torch.tensor([[False, True, False, False, True, False]])
    with torch.no_grad():
        before = model(ids, text([0]).pooled, condition)
        for slot in range(6):
            changed = ids.clone()
            changed[0, slot] = (ids[0, slot] + 1) % CODES
            equal = (model(changed, text([0]).pooled, condition) == before).all(-1)[0]
            blind = torch.ones(7, dtype=torch.bool)
            if not condition[0, slot]:
                blind = torch.cat((torch.ones(1, dtype=torch.bool), condition[0])) | (torch.arange(7) <= slot)
                assert torch.equal(equal, blind)
            else:
                assert not equal.any()


# Training


@pytest.mark.parametrize("norm", ["pre", "post"])
def test_every_parameter_learns(norm):
    """Give every code and END as inputs: their rows learn, that of PAD has no influence."""
    model = make(norm).train()
    codes = torch.cat((torch.arange(CODES), torch.zeros(1))).long()[None, :, None]
    batch = Latents(torch.tensor([12]), torch.tensor([48]), codes=codes)
    drawn = replace(draws(1, condition_drop=0.0), condition=torch.ones(1, SLOTS, dtype=torch.bool))
    drawn.corrupted[:] = False
    model.loss(batch, text([0]), draws=drawn)["loss"].backward()
    assert [name for name, p in model.named_parameters() if p.grad is None or not p.grad.any()] == []
    assert model.token_embedding.weight.grad.any(dim=1).tolist() == [True] * (CODES + 1) + [False]


def test_loss_is_a_function_of_the_generator():
    model = make()
    first, again, *others = (
        model.loss(latents(), text(), generator=torch.Generator().manual_seed(seed))["loss"] for seed in (3, 3, 4, 5, 6)
    )
    assert torch.equal(first, again)
    assert any(not torch.equal(first, other) for other in others)


def test_loss_averages_codes_and_end_of_each_sample():
    """Compare with the definition, one sample at a time."""
    model, batch, drawn = make(), latents(), draws(seed=16)
    assert drawn.condition.any()
    assert drawn.corrupted.any()
    expected = []
    for i, length in enumerate(batch.lengths.tolist()):
        ids = torch.cat((batch.codes[i, :length, 0], torch.tensor([CODES])))
        seen = torch.where(drawn.corrupted[i, : length + 1] & (ids != CODES), drawn.codes[i, : length + 1], ids)
        pooled = text().pooled[i : i + 1] * ~drawn.condition_drop[i]
        logits = model(seen[None], pooled, drawn.condition[i : i + 1, : length + 1])[0, :-1]
        expected.append(torch.nn.functional.cross_entropy(logits, ids))
    close(model.loss(batch, text(), draws=drawn)["loss"], torch.stack(expected).mean())


def test_padding_never_reaches_the_loss():
    model, clean, drawn = make(), latents(torch.tensor([20, 20, 36])), draws(seed=16)
    garbage = replace(clean, codes=torch.where(clean.mask[..., None], clean.codes, 99))
    wider = replace(clean, codes=torch.cat((garbage.codes, torch.full((3, 3, 1), -7)), dim=1))
    losses = [
        model.loss(x, text(), draws=drawn.crop(slice(None), x.codes.shape[1] + 1))["loss"]
        for x in (clean, garbage, wider)
    ]
    assert torch.equal(losses[0], losses[1])
    close(losses[0], losses[2])


def test_rates_are_those_of_a_batch():
    """Half of the batches have conditions; both rates are uniform in (0, 0.5), one for all samples (BAMM, Training)."""
    batches = [draws(seed=seed, shape=(64, 50)) for seed in range(300)]
    conditions, corruptions = (
        torch.stack([getattr(d, name).float().mean(dim=1) for d in batches]) for name in ("condition", "corrupted")
    )
    conditioned = conditions.mean(dim=1) > 0.004
    assert conditioned.float().mean().item() == pytest.approx(0.5, abs=0.08)
    for rates in (conditions[conditioned].mean(dim=1), corruptions.mean(dim=1)):
        assert rates.mean().item() == pytest.approx(0.25, abs=0.03)
        assert rates.std().item() == pytest.approx(0.144, abs=0.02)
        assert rates.max() < 0.53
    within = conditions[conditioned].var(dim=1)
    rate = conditions[conditioned].mean(dim=1)
    assert (within.mean() / (rate * (1 - rate) / 50).mean()).item() == pytest.approx(1, abs=0.1)
    dropped = torch.stack([d.condition_drop.float().mean() for d in batches]).mean()
    assert dropped.item() == pytest.approx(0.1, abs=0.01)


def test_texts_are_dropped_and_codes_corrupted_in_training_only():
    model, batch = make(condition_drop=1.0, dropout=0.0), latents()
    other = TextFeatures(["", "", ""], torch.randn(3, 5))

    def losses(*texts: TextFeatures) -> list[torch.Tensor]:
        return [model.loss(batch, t, generator=torch.Generator().manual_seed(0))["loss"] for t in texts]

    assert not torch.equal(*losses(text(), other))
    plain = losses(replace(text(), pooled=torch.zeros(3, 5)))[0]
    model.train()
    assert torch.equal(*losses(text(), other))
    assert not torch.equal(losses(text())[0], plain)


def test_ranks_average_to_the_loss_of_one_process(monkeypatch):
    model, batch = make(dropout=0.0).train(), latents(torch.tensor([48, 20, 36, 8]))
    monkeypatch.setattr(ranks.distributed, "is_initialized", lambda: False)

    def losses(rows: list[int], shard: tuple[int, int]) -> torch.Tensor:
        part = Latents(batch.lengths[rows], batch.frames[rows], codes=batch.codes[rows])
        made = model.loss(part, text(rows), generator=torch.Generator().manual_seed(5), shard=shard)
        return torch.stack([made["loss"], made["accuracy"]])

    whole = losses([0, 1, 2, 3], (0, 1))
    close((losses([0, 1], (0, 2)) + losses([2, 3], (1, 2))) / 2, whole)


# Generation


def whole_sequence(
    model: BAMM,
    ids: torch.Tensor,
    condition: torch.Tensor,
    lengths: torch.Tensor,
    scale: float,
    classes: int,
    pick: Callable[[int, torch.Tensor], torch.Tensor],
) -> tuple[torch.Tensor, torch.Tensor]:
    """Decode by the definition, the whole sequence anew for each slot; gives the ids and the draws' probabilities."""
    ids, confidence = ids.clone(), torch.zeros(ids.shape)
    for slot in range(int(lengths.max())):
        with torch.no_grad():
            halves = [model(ids, pooled, condition)[:, slot] for pooled in (text().pooled, text().pooled * 0)]
        logits = (halves[1] + scale * (halves[0] - halves[1]))[:, :classes]
        token = pick(slot, logits[:, None])
        confidence[:, slot] = logits.softmax(-1).gather(1, token)[:, 0]
        free = ~condition[:, slot] & (slot < lengths)
        ids[:, slot] = torch.where(free, token[:, 0], ids[:, slot])
    return ids, confidence


@pytest.mark.parametrize("norm", ["pre", "post"])
@pytest.mark.parametrize("remask", ["confidence", "order"])
def test_both_iterations_are_their_definition(norm, remask):
    """Compare with whole-sequence decoding: what is cached changes nothing."""
    model, lengths, seeded = make(norm), FRAMES // 4, SeededDraws(SEEDS)
    real = frame_mask(lengths, 12)
    ids, confidence = whole_sequence(
        model, torch.zeros(3, SLOTS).long(), torch.zeros(3, SLOTS).bool(), lengths, 2.5, CODES, seeded.pick
    )
    first = model.sample(text(), FRAMES, seeds=SEEDS, sampling=replace(SAMPLING, iterations=1))
    assert torch.equal(first.codes[..., 0], ids[:, :12].masked_fill(~real, 0))
    scores = (confidence[:, :12] if remask == "confidence" else seeded.order(12)).masked_fill(~real, torch.inf)
    condition = torch.zeros(3, SLOTS).bool()
    for i, length in enumerate(lengths.tolist()):
        again = scores[i].argsort()[: max(1, round(length / 2))]
        condition[i, :length] = True
        condition[i, again] = False
        condition[i, length] = True
        ids[i, length] = CODES
    expected, _ = whole_sequence(
        model, ids, condition, lengths, 2.0, CODES, lambda slot, logits: seeded.pick(12 + slot, logits)
    )
    second = model.sample(text(), FRAMES, seeds=SEEDS, sampling=replace(SAMPLING, remask=remask))
    assert torch.equal(second.codes[..., 0], expected[:, :12].masked_fill(~real, 0))
    assert not torch.equal(first.codes, second.codes)
    assert torch.equal(second.codes[..., 0][condition[:, :12] & real], first.codes[..., 0][condition[:, :12] & real])


@pytest.mark.parametrize("norm", ["pre", "post"])
def test_cached_logits_are_those_of_the_whole_sequence(norm):
    model, ids = make(norm), torch.randint(CODES, (3, SLOTS), generator=torch.Generator().manual_seed(0))
    condition = some(0.4, SLOTS)
    with torch.no_grad():
        rows = CachedRows(model, text().pooled, ids, condition, ~condition)
        expected = model(ids, text().pooled, condition)
        for slot in range(SLOTS):
            close(rows(slot, ids), expected[:, slot])


@pytest.mark.parametrize("frames", [FRAMES, None], ids=["given", "predicted"])
@pytest.mark.parametrize("remask", ["confidence", "order"])
def test_samples_do_not_depend_on_batch_order_or_padding(frames, remask):
    model, sampling = make(), replace(SAMPLING, remask=remask)
    together = model.sample(text(), frames, seeds=SEEDS, sampling=sampling)
    for rows in ([1], [2, 1], [2, 0, 1]):
        some = model.sample(text(rows), None if frames is None else frames[rows], seeds=SEEDS[rows], sampling=sampling)
        assert torch.equal(some.lengths, together.lengths[rows])
        for i, row in enumerate(rows):
            length = int(together.lengths[row])
            assert torch.equal(some.codes[i, :length], together.codes[row, :length])


def test_seed_text_and_guidance_matter():
    model = make()
    base = model.sample(text(), FRAMES, seeds=SEEDS).codes
    assert torch.equal(base, model.sample(text(), FRAMES, seeds=SEEDS).codes)
    for other in (
        model.sample(text(), FRAMES, seeds=SEEDS + 10),
        model.sample(text([2, 0, 1]), FRAMES, seeds=SEEDS),
        model.sample(text(), FRAMES, seeds=SEEDS, sampling=replace(SAMPLING, guidance=1.0)),
        model.sample(text(), FRAMES, seeds=SEEDS, sampling=replace(SAMPLING, second_guidance=1.0)),
        model.sample(text(), FRAMES, seeds=SEEDS, sampling=replace(SAMPLING, temperature=0)),
    ):
        assert not torch.equal(base, other.codes)


def test_given_frames_are_exact_and_padding_is_zero():
    model = make()
    torch.nn.init.constant_(model.encoder.output[-1].bias[CODES:], 50.0)  # END would come first
    result = model.sample(text(), torch.tensor([49, 20, 7]), seeds=SEEDS)
    assert result.lengths.tolist() == [12, 5, 1]
    assert result.frames.tolist() == [48, 20, 4]
    assert not result.codes[~result.mask].any()
    assert (result.codes < CODES).all()


class EndAt(Greedy):
    """Draw END at given steps of the first iteration, code 7 elsewhere."""

    def __init__(self, *steps: int) -> None:
        super().__init__(SEEDS)
        self.steps, self.asked = torch.tensor(steps), []

    def pick(self, step: int, logits: torch.Tensor) -> torch.Tensor:
        self.asked.append(step)
        return torch.where(self.steps <= step, CODES, 7)[:, None]


def test_end_cuts():
    """END first leaves one code 0; no END gives the longest motion; no slot follows when all have ended."""
    model, sampling = make(), replace(SAMPLING, iterations=1)
    result = model.sample(text(), None, seeds=SEEDS, draws=EndAt(4, 0, 99), sampling=sampling)
    assert result.lengths.tolist() == [4, 1, 12]
    assert result.frames.tolist() == [16, 4, 48]
    assert result.codes[..., 0].tolist() == [[7] * 4 + [0] * 8, [0] * 12, [7] * 12]
    drawn = EndAt(4, 0, 2)
    assert model.sample(text(), None, seeds=SEEDS, draws=drawn, sampling=sampling).codes.shape == (3, 4, 1)
    assert drawn.asked == [0, 1, 2, 3, 4]


def test_predicted_lengths_are_those_of_the_first_iteration():
    model = make()
    with torch.no_grad():
        model.encoder.output[-1].bias[CODES] += 1.5
    one, two = (model.sample(text(), None, seeds=SEEDS, sampling=replace(SAMPLING, iterations=n)) for n in (1, 2))
    assert len(set(one.lengths.tolist())) > 1
    assert torch.equal(one.lengths, two.lengths)
    assert not torch.equal(one.codes, two.codes)


def test_further_iterations_regenerate_further_halves():
    model = make()
    results = [model.sample(text(), FRAMES, seeds=SEEDS, sampling=replace(SAMPLING, iterations=n)) for n in (1, 2, 3)]
    for before, after in itertools.pairwise(results):
        changed = (before.codes != after.codes).any(-1).sum(dim=1)
        assert (changed <= torch.tensor([6, 2, 4])).all()
        assert changed.any()


def test_guidance_decides_how_many_rows_the_transformer_takes():
    model, rows = make(), []
    model.encoder.blocks[0].register_forward_hook(lambda module, inputs, output: rows.append(len(output)))
    for guidance, expected in ((1.0, {3}), (0.0, {3}), (2.5, {6})):
        rows.clear()
        sampling = replace(SAMPLING, guidance=guidance, second_guidance=guidance)
        model.sample(text(), FRAMES, seeds=SEEDS, sampling=sampling)
        assert set(rows) == expected


def test_work_of_a_generation():
    """Count rows: one per slot and iteration, before them the conditions', of which only half are codes."""
    model, rows, drawn = make(), [], Greedy(SEEDS[:1])
    model.encoder.blocks[0].register_forward_hook(lambda module, inputs, output: rows.append(output.shape[1]))
    drawn.order = lambda size: (torch.arange(size) % 2)[None].float()
    model.sample(text([0]), FRAMES[:1], seeds=SEEDS[:1], draws=drawn, sampling=replace(SAMPLING, remask="order"))
    assert rows == [1] * 12 + [1 + 6 + 1] + [1] * 11


def test_training_mode_is_left_alone_and_has_no_dropout_in_samples():
    model = make()
    expected = model.sample(text(), FRAMES, seeds=SEEDS).codes
    model.train()
    assert torch.equal(model.sample(text(), FRAMES, seeds=SEEDS).codes, expected)
    assert model.training
    assert model.encoder.blocks[0].training


def test_a_residual_transformer_completes_the_codes():
    torch.manual_seed(1)
    residual = ResidualTransformer(
        codebook_size=CODES, code_dim=6, text_dim=5, quantizers=3, width=16, feedforward=24, layers=1, heads=2,
        max_latents=12,
    )  # fmt: skip
    model = make().eval()
    base = model.sample(text(), None, seeds=SEEDS)
    model.attach("residual", residual.eval())
    result = model.sample(text(), None, seeds=SEEDS)
    assert result.codes.shape[2] == 3
    assert torch.equal(result.codes[..., :1], base.codes)
    assert torch.equal(result.lengths, base.lengths)


# Editing


def known(keep: torch.Tensor) -> Known:
    return Known(latents(), keep)


@pytest.mark.parametrize("official", [False, True])
def test_edit_keeps_codes_and_regenerates_the_rest(official):
    keep = some(0.5)
    keep[1], keep[2] = True, False
    source, sampling = latents(), replace(SAMPLING, official_inference=official)
    result = make().sample(text(), None, seeds=SEEDS, known=known(keep), sampling=sampling)
    kept, free = keep & source.mask, ~keep & source.mask
    assert torch.equal(result.codes[kept], source.codes[kept])
    assert (result.codes[free] != source.codes[free]).any()
    assert torch.equal(result.lengths, source.lengths)
    assert not result.codes[~source.mask].any()


@pytest.mark.parametrize("norm", ["pre", "post"])
def test_edit_is_its_definition(norm):
    keep, lengths, model = some(0.5), FRAMES // 4, make(norm)
    ids = torch.nn.functional.pad(latents().codes[..., 0], (0, 1)).scatter(1, lengths[:, None], CODES)
    condition = torch.nn.functional.pad(keep & latents().mask, (0, 1)).scatter(1, lengths[:, None], True)
    expected, _ = whole_sequence(model, ids, condition, lengths, 2.0, CODES, SeededDraws(SEEDS).pick)
    result = model.sample(text(), None, seeds=SEEDS, known=known(keep))
    assert torch.equal(result.codes[..., 0], expected[:, :12].masked_fill(~latents().mask, 0))


def test_edit_reads_its_text_unless_official():
    model, keep = make(), some(0.3)
    for official in (False, True):
        sampling = replace(SAMPLING, official_inference=official)
        one, other = (
            model.sample(text(rows), None, seeds=SEEDS, known=known(keep), sampling=sampling).codes
            for rows in (None, [3, 0, 1])
        )
        assert torch.equal(one, other) == official


def test_free_positions_of_the_source_do_not_leak():
    keep, model, source = some(0.5), make(), latents()
    changed = replace(source, codes=torch.where(keep[..., None], source.codes, (source.codes + 1) % CODES))
    results = [model.sample(text(), None, seeds=SEEDS, known=Known(x, keep)).codes for x in (source, changed)]
    assert torch.equal(results[0], results[1])


def test_edit_sees_kept_codes_on_both_sides():
    """Change a kept code at the end: an earlier free one changes for some of several values."""
    keep, model = torch.zeros(3, 12, dtype=torch.bool), make()
    keep[0, 11] = True
    results = []
    for code in range(CODES):
        source = latents()
        source.codes[0, 11] = code
        results.append(model.sample(text(), None, seeds=SEEDS, known=Known(source, keep)).codes[0, :11, 0].tolist())
    assert len(set(map(tuple, results))) > 1


def test_edit_costs_what_is_free():
    """Keep all but slots 4 and 5 of the longest sample: rows 4, 5 and 6 follow the conditions."""
    model, calls = make(), []
    model.encoder.blocks[0].register_forward_hook(lambda module, inputs, output: calls.append(output.shape[1]))
    keep = torch.ones(3, 12, dtype=torch.bool)
    keep[0, 4:6] = False
    model.sample(text(), None, seeds=SEEDS, known=known(keep))
    assert calls == [12, 1, 1, 1]


def test_edit_with_everything_known_returns_the_source():
    source = latents()
    result = make().sample(text(), FRAMES, seeds=SEEDS, known=known(torch.ones(3, 12, dtype=torch.bool)))
    assert torch.equal(result.codes, source.codes * source.mask[..., None])


# Errors


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda m: m.sample(text(), torch.tensor([3, 20, 20]), seeds=SEEDS), "cannot generate 3 frames; give 4 to 48"),
        (lambda m: m.sample(text(), torch.tensor([20, 52, 20]), seeds=SEEDS), "cannot generate 52 frames"),
        (lambda m: m.sample(text([0, 1]), None, seeds=SEEDS), "3 lengths, 2 texts and 3 seeds"),
        (
            lambda m: m.sample(text(), FRAMES - 4, seeds=SEEDS, known=known(torch.ones(3, 12, dtype=torch.bool))),
            "pass frames=None",
        ),
        (lambda m: m.loss(replace(latents(), codes=latents().codes + CODES), text()), "codebook_size=11 allows 0 to"),
        (
            lambda m: m.loss(Latents(FRAMES // 4, FRAMES, values=torch.zeros(3, 12, 6)), text()),
            "the tokenizer gives continuous values",
        ),
        (lambda m: make("both"), "BAMM.norm=both: must be one of pre, post"),
        (lambda m: make(heads=3), "heads 3"),
        (lambda m: replace(SAMPLING, iterations=0), "BammSampling.iterations=0: must be a whole number from 1"),
        (lambda m: replace(SAMPLING, temperature=-1.0), "BammSampling.temperature=-1.0: must be"),
        (lambda m: replace(SAMPLING, remask="half"), "BammSampling.remask=half: must be one of confidence, order"),
        (
            lambda m: replace(SAMPLING, residual_top_k=1.0),
            "BammSampling.residual_top_k=1.0: must be .* < 1",
        ),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call(make())

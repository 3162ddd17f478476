"""Test ReMoDiffuse: what is retrieved and what may not be, the mixture of passes, and that nothing else leaks."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace

import pytest
import torch

from kinema.diffusion.ddpm import DDPM
from kinema.generators.remodiffuse import MixtureSampling, ReMoDiffuse, RetrievalDatabase
from kinema.generators.remodiffuse.database import best
from kinema.generators.remodiffuse.mixture import flip
from kinema.generators.remodiffuse.model import RetrievalDraws
from kinema.types import Known, Latents, TextFeatures, frame_mask

LENGTHS, SEEDS, MOST = torch.tensor([12, 5, 9]), torch.tensor([11, 12, 13]), 14
NAMES = ["walk", "Mwalk", "walk#0", "Mary", "run", "jump"]
FAMILIES = torch.tensor([0, 0, 0, 1, 2, 3])
SIZES = torch.tensor([12, 12, 4, 9, 14, 5])


def database(*, order: tuple[int, ...] = tuple(range(8))) -> RetrievalDatabase:
    """Make six entries with eight captions, two of them of equal text; `walk#0` is a view of `walk`'s frames."""
    generator = torch.Generator().manual_seed(5)
    pooled = torch.randn(7, 5, generator=generator)
    tokens = [torch.randn(2 + i % 4, 7, generator=generator) for i in range(7)]
    captions = torch.tensor([[0, 0], [0, 1], [1, 0], [2, 2], [3, 3], [4, 4], [5, 4], [6, 5]])
    return RetrievalDatabase.holding(
        pooled=pooled,
        tokens=tokens,
        frames=torch.randn(12 + 12 + 9 + 14 + 5, 6, generator=generator),
        starts=torch.tensor([0, 12, 3, 24, 33, 47]),
        lengths=SIZES,
        families=FAMILIES,
        captions=captions[list(order)],
        names=NAMES,
    )


def make(**options) -> ReMoDiffuse:
    """Make a tiny model whose layers all have an influence, with a database."""
    torch.manual_seed(0)
    sizes = {
        "frame_dim": 6,
        "token_dim": 7,
        "width": 16,
        "feedforward": 24,
        "layers": 2,
        "heads": 2,
        "max_frames": MOST,
    }
    text_sizes = {"text_width": 8, "text_feedforward": 10, "text_layers": 1, "text_heads": 2}
    sampling = MixtureSampling(solver_steps=6)
    process = DDPM(100, "linear", "x0")
    model = ReMoDiffuse(process=process, **(sizes | text_sizes | {"sampling": sampling} | options))
    for parameter in model.parameters():
        torch.nn.init.normal_(parameter, std=0.25)
    model.attach("retrieval", database())
    return model.eval()


def text(rows: list[int] | None = None, names: tuple[str, ...] = ("walk", "run", "other")) -> TextFeatures:
    generator = torch.Generator().manual_seed(1)
    pooled, tokens = torch.randn(4, 5, generator=generator), torch.randn(4, 6, 7, generator=generator)
    rows = [0, 1, 2] if rows is None else rows
    counts = torch.tensor([6, 2, 4, 3])[rows]
    seen = frame_mask(counts, int(counts.max()))
    own = tokens[rows][:, : seen.shape[1]] * seen[..., None]
    return TextFeatures([str(i) for i in rows], pooled[rows], own, seen, [names[i] for i in rows])


def latents() -> Latents:
    values = torch.randn(3, 12, 6, generator=torch.Generator().manual_seed(2))
    return Latents(LENGTHS, LENGTHS, values=values * frame_mask(LENGTHS, 12)[..., None])


def draws(model: ReMoDiffuse, positions: int, drop: float = 0.0) -> RetrievalDraws:
    drawn = RetrievalDraws.draw(
        (3, MOST, 6),
        model.process,
        condition_drop=drop,
        generator=torch.Generator().manual_seed(0),
        device=torch.device("cpu"),
    )
    return drawn.crop(slice(None), positions)


def close(a: torch.Tensor, b: torch.Tensor, atol: float = 1e-4) -> None:
    torch.testing.assert_close(a, b, rtol=1e-4, atol=atol)


# Retrieval


def test_scores_are_those_of_a_loop():
    found, asked = database(), text()
    scores = found.scores(asked.pooled, LENGTHS, length_weight=0.3)
    for i, length in enumerate(LENGTHS.tolist()):
        for j, (row, entry) in enumerate(found.captions.tolist()):
            own = SIZES[entry].item()
            cosine = torch.cosine_similarity(asked.pooled[i], found.keys[row], dim=0)
            kernel = torch.exp(torch.tensor(-0.3 * abs(own - length) / max(own, length)))
            close(scores[i, j], cosine * kernel, 1e-6)


def test_equal_scores_go_to_the_first():
    scores = torch.tensor([[1.0, 3.0, 3.0, 2.0, 3.0], [0.0, 0.0, 0.0, 0.0, 0.0]])
    assert best(scores, 3).tolist() == [[1, 2, 4], [0, 1, 2]]
    assert best(scores, 2, scores == 3).tolist()[0] == [3, 0]
    found = database()
    equal = found.scores(text().pooled, LENGTHS)[:, :2]  # the same text and length twice
    assert torch.equal(equal[:, 0], equal[:, 1])


def test_a_neighbour_comes_with_its_own_frames_and_tokens():
    found = database()
    rows = torch.tensor([[0, 3], [7, 4]])
    neighbours = found.gather(rows)
    assert neighbours.lengths.tolist() == [[12, 4], [5, 9]]
    assert torch.equal(neighbours.motions[0, 1, :4], found.frames[3:7])
    assert torch.equal(neighbours.motions[1, 0, :5], found.frames[47:52])
    assert not neighbours.motions[0, 1, 4:].any()
    assert neighbours.token_lengths.tolist() == [[2, 4], [4, 5]]
    assert torch.equal(neighbours.tokens[0, 1, :4], found.tokens[5:9])
    assert not neighbours.tokens[0, 0, 2:].any()


def test_a_clip_its_parts_and_its_mirror_image_are_excluded_by_name():
    """`Mary` is no mirror image of `ary`, and a clip of another split excludes nothing."""
    excluded = database().same_clip(["walk#0", "Mwalk", "Mary", "unknown"])
    walk = [True, True, True, True, False, False, False, False]
    assert excluded.tolist() == [walk, walk, [i == 4 for i in range(8)], [False] * 8]
    assert database().same_length(torch.tensor([9])).tolist() == [[i == 4 for i in range(8)]]


@pytest.mark.parametrize("exclusion", ["same_id", "legacy_length"])
def test_exclusion_is_for_training(exclusion):
    model, seen = make(exclusion=exclusion), []
    model.denoiser.retrieval.register_forward_hook(lambda module, inputs, output: seen.append(inputs[0].lengths))
    asked = replace(text(), pooled=database().keys[[0, 4, 6]])  # each is a caption of the database
    lengths = torch.tensor([12, 14, 5])
    model.retrieve(asked, lengths)
    assert seen[0][:, 0].tolist() == [12, 14, 5]
    model.train()
    model.retrieve(replace(asked, clip_ids=["Mwalk", "run", "jump"]), lengths)
    assert (seen[1] != lengths[:, None]).all()


def test_without_clip_ids_training_would_copy_itself():
    model = make().train()
    with pytest.raises(ValueError, match="0 clip ids for 3 samples"):
        model.loss(latents(), replace(text(), clip_ids=[]))


def test_copies_share_the_database():
    model = make()
    copy = deepcopy(model)
    assert copy.database is model.database
    assert not any("keys" in name for name in model.state_dict())


# Training


def test_every_parameter_learns():
    model = make().train()
    model.loss(latents(), text(), generator=torch.Generator().manual_seed(0))["loss"].backward()
    assert [n for n, p in model.named_parameters() if p.grad is None or not p.grad.any()] == []


def test_conditions_are_dropped_independently():
    model = make()
    drawn = RetrievalDraws.draw(
        (20000, 1, 1),
        model.process,
        condition_drop=0.1,
        generator=torch.Generator().manual_seed(0),
        device=torch.device("cpu"),
    )
    both = drawn.condition_drop & drawn.retrieval_drop
    shares = [flags.float().mean().item() for flags in (drawn.condition_drop, drawn.retrieval_drop, both)]
    assert shares == pytest.approx([0.1, 0.1, 0.01], abs=0.006)


@pytest.mark.parametrize("kept", ["condition_drop", "retrieval_drop"])
def test_what_is_dropped_has_no_influence(kept):
    """Give other texts where text is dropped, and other neighbours where these are."""
    model, drawn = make(), draws(make(), 12)
    drawn = replace(drawn, **{kept: torch.ones(3, dtype=torch.bool)})
    base = model.loss(latents(), text(), draws=drawn)["loss"]
    asked = text()
    changed = replace(asked, tokens=asked.tokens.flip(0)) if kept == "condition_drop" else asked
    if kept == "retrieval_drop":
        model.attach("retrieval", database(order=(7, 5, 4)))
    close(model.loss(latents(), changed, draws=drawn)["loss"], base, 1e-6)
    nothing = replace(drawn, **{kept: torch.zeros(3, dtype=torch.bool)})
    assert not torch.allclose(model.loss(latents(), changed, draws=nothing)["loss"], base, atol=1e-5)


def test_padding_never_reaches_the_loss():
    model, clean = make(), latents()
    wider = replace(clean, values=torch.cat((clean.values, torch.full((3, 2, 6), 1e6)), dim=1))
    losses = [model.loss(x, text(), draws=draws(model, x.values.shape[1]))["loss"] for x in (clean, wider)]
    close(losses[0], losses[1], 1e-6)


# Sampling


def test_a_sample_depends_on_its_own_seed_text_and_length_alone():
    model = make()
    made = model.sample(text(), LENGTHS, seeds=SEEDS).values
    for i in range(3):
        alone = model.sample(text([i]), LENGTHS[[i]], seeds=SEEDS[[i]]).values
        close(alone[0], made[i, : LENGTHS[i]])
    backwards = model.sample(text([2, 1, 0]), LENGTHS.flip(0), seeds=SEEDS.flip(0)).values
    close(backwards.flip(0), made)
    other = model.sample(text(), LENGTHS, seeds=SEEDS + 1).values
    assert not torch.allclose(other, made, atol=1e-3)


def test_a_sample_ignores_the_clip_that_it_is_the_caption_of():
    """ReMoDiffuse §2: caption and length are all that retrieval is given."""
    model = make()
    made = model.sample(text(), LENGTHS, seeds=SEEDS).values
    renamed = replace(text(), clip_ids=["jump", "walk", "Mwalk"], texts=["a", "b", "c"])
    assert torch.equal(model.sample(renamed, LENGTHS, seeds=SEEDS).values, made)


def test_what_is_retrieved_matters():
    model = make()
    made = model.sample(text(), LENGTHS, seeds=SEEDS).values
    model.attach("retrieval", database(order=(7, 5, 4)))
    assert not torch.allclose(model.sample(text(), LENGTHS, seeds=SEEDS).values, made, atol=1e-3)


def test_weights_sum_to_one_and_coins_are_fair():
    options = MixtureSampling()
    for share in (1.0, 0.4, 0.1, 0.0):
        weights = options.mixture(share, torch.tensor([False, True]))
        close(weights.sum(dim=1), torch.ones(2, dtype=torch.float64), 1e-12)
    tossed = torch.stack([flip(torch.arange(200), time) for time in range(50)]).float()
    assert tossed.mean().item() == pytest.approx(0.5, abs=0.02)
    assert tossed.mean(dim=0).std().item() == pytest.approx(0.5 / 50**0.5, rel=0.3)


def test_passes_without_a_weight_cost_nothing():
    model, rows = make(), []
    model.denoiser.blocks[0].register_forward_hook(lambda module, inputs, output: rows.append(len(output)))
    model.sample(text(), LENGTHS, seeds=SEEDS)
    once = int(LENGTHS.sum())
    assert rows == [2 * once] * 5 + [4 * once]


def test_an_edit_keeps_bits_and_regenerates_the_rest():
    model, source = make(), latents()
    keep = frame_mask(LENGTHS, 12)
    keep[:, 2:4] = False
    made = model.sample(text(), None, seeds=SEEDS, known=Known(source, keep))
    assert torch.equal(made.values[keep], source.values[keep])
    free = ~keep & source.mask
    assert (made.values[free] != source.values[free]).all()


# Errors


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: make(neighbours=9), "8 captions, fewer than the 9 neighbours"),
        (lambda: make(frame_dim=5), "frames of 6 numbers, this model reads 5"),
        (lambda: make(token_dim=5), "token features of 7 numbers, this model reads 5"),
        (lambda: make(exclusion="none"), "ReMoDiffuse.exclusion=none: must be one of same_id, legacy_length"),
        (lambda: make(heads=3), "heads 3"),
        (lambda: make().attach("retrieval", torch.nn.Linear(1, 1)), "a Linear is no retrieval database"),
        (lambda: make().attach("residual", database()), "takes no 'residual'; it takes retrieval"),
        (lambda: MixtureSampling(guidance=2.0), "mixes four passes instead"),
        (lambda: database().scores(torch.zeros(1, 4), LENGTHS[:1]), "features of 5 numbers, not of 4"),
        (lambda: best(torch.zeros(1, 3), 2, torch.tensor([[True, False, True]])), "fewer than 2 captions are left"),
        (lambda: make().loss(latents(), replace(text(), tokens=None)), "attends to tokens"),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_a_model_without_a_database_says_so():
    model = make()
    model._database = ()
    with pytest.raises(ValueError, match="retrieves from a database and has none"):
        model.sample(text(), LENGTHS, seeds=SEEDS)


def test_words_may_be_read_as_they_are():
    model = make(text_layers=0, retrieval_text_layers=0)
    made = model.sample(text(), LENGTHS, seeds=torch.tensor([1, 2, 3]))
    assert torch.isfinite(made.values).all()


@pytest.mark.parametrize("unread", [{"renewal": 0.5}, {"guidance_growing": True}, {"guidance_interval": [0.0, 0.5]}])
def test_what_the_mixture_does_not_read_is_refused(unread):
    with pytest.raises(ValueError, match=rf"sampling.{next(iter(unread))} is .*, which ReMoDiffuse's mixture doesn't"):
        MixtureSampling(**unread)

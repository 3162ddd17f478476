"""Test diffusion on the latents of a motion: its empty text, lengths and invariances (numbers: tests/parity)."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from kinema.diffusion.ddpm import DDPM
from kinema.generators.frames.training import FrameDraws
from kinema.generators.mld import MLD, LatentSampling
from kinema.types import Known, Latents, TextFeatures

FRAMES, SEEDS = torch.tensor([12, 5, 9]), torch.tensor([11, 12, 13])
EMPTY = TextFeatures([""], torch.full((1, 5), 0.7))


def make(empty: TextFeatures | None = EMPTY, **options) -> MLD:
    torch.manual_seed(0)
    sizes = {"text_dim": 5, "latents": 2, "latent_dim": 8, "feedforward": 12, "layers": 3, "heads": 2, "time_dim": 6}
    model = MLD(process=DDPM(40, "scaled_linear"), **(sizes | {"sampling": ddim()} | options))
    for parameter in model.parameters():
        torch.nn.init.normal_(parameter, std=0.4)
    if empty is not None:
        model.take_empty_text(empty)
    return model.eval()


def ddim(guidance: float = 3.0) -> LatentSampling:
    return LatentSampling(guidance=guidance, solver="ddim", solver_steps="leading4")


def text(rows: slice | list[int] = slice(None)) -> TextFeatures:
    pooled = torch.randn(3, 5, generator=torch.Generator().manual_seed(1))[rows]
    return TextFeatures([""] * len(pooled), pooled)


def latents() -> Latents:
    values = torch.randn(3, 2, 8, generator=torch.Generator().manual_seed(2))
    return Latents(torch.full((3,), 2), FRAMES, values)


def test_a_motion_of_any_length_has_the_same_number_of_latents():
    made = make().sample(text(), FRAMES, seeds=SEEDS)
    assert made.values.shape == (3, 2, 8)
    assert made.lengths.tolist() == [2, 2, 2]
    assert torch.equal(made.frames, FRAMES)


def test_a_sample_depends_on_its_own_seed_and_text_alone():
    model, rows = make(), [2, 0]
    whole = model.sample(text(), FRAMES, seeds=SEEDS).values
    part = model.sample(text(rows), FRAMES[rows], seeds=SEEDS[rows]).values
    torch.testing.assert_close(part, whole[rows], rtol=1e-4, atol=1e-4)
    assert not torch.allclose(model.sample(text(), FRAMES, seeds=SEEDS + 1).values, whole, atol=1e-2)


def test_guidance_starts_from_the_empty_text():
    """Its features given as the text make guidance idle; zeros do not."""
    model = make()
    for pooled, idle in ((EMPTY.pooled.expand(3, -1), True), (torch.zeros(3, 5), False)):
        features = TextFeatures([""] * 3, pooled)
        plain, strong = (model.sample(features, FRAMES, seeds=SEEDS, sampling=ddim(g)).values for g in (1.0, 7.5))
        assert torch.allclose(plain, strong, rtol=1e-4, atol=1e-4) == idle


def test_a_dropped_text_is_the_empty_one_in_training():
    model, features = make(), text()
    noise, time = torch.randn(3, 2, 8), torch.tensor([1, 20, 39])
    dropped = torch.tensor([True, False, True])
    emptied = replace(features, pooled=torch.where(dropped[:, None], EMPTY.pooled, features.pooled))
    losses = [
        model.loss(latents(), read, draws=FrameDraws(drop, time, noise))["loss"]
        for read, drop in ((features, dropped), (emptied, dropped & False))
    ]
    assert torch.equal(*losses)
    model.train()
    drawn = model._draw(latents().values.repeat(200, 1, 1), torch.Generator().manual_seed(0), (0, 1))
    assert 0.05 < drawn.condition_drop.float().mean() < 0.15


def test_the_empty_text_is_saved_and_missed():
    model = make()
    copy = make(empty=None)
    assert copy.lacks_empty_text
    with pytest.raises(ValueError, match="no features of the empty text"):
        copy.sample(text(), FRAMES, seeds=SEEDS)
    copy.load_state_dict(model.state_dict())
    assert not copy.lacks_empty_text
    assert torch.equal(copy.empty_text, EMPTY.pooled[0])


def test_nothing_can_be_kept_of_a_motion():
    known = Known(latents(), torch.ones(3, 2, dtype=torch.bool))
    with pytest.raises(ValueError, match="needs latents in time, but here 2 latents stand for the whole of a motion"):
        make().sample(text(), None, seeds=SEEDS, known=known)


def test_ranks_draw_as_one_process():
    model, values = make().train(), latents().values
    whole = model._draw(values.repeat(2, 1, 1), torch.Generator().manual_seed(5), (0, 1))
    for rank in (0, 1):
        share = model._draw(values, torch.Generator().manual_seed(5), (rank, 2))
        rows = slice(3 * rank, 3 * rank + 3)
        assert torch.equal(share.noise, whole.noise[rows])
        assert torch.equal(share.time, whole.time[rows])
        assert torch.equal(share.condition_drop, whole.condition_drop[rows])

"""A clip's codes and reconstruction are its own, whatever pads it; the losses read the right columns."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from torch import nn

from kinema.experiments.config import compose, plain
from kinema.motion.representation import Representation
from kinema.motion.statistics import Statistics
from kinema.runs.build import build
from kinema.tokenizers import MotionTokenizer
from kinema.tokenizers.codebook import EMACodebook
from kinema.tokenizers.rvq import ResidualQuantizer
from kinema.tokenizers.vq import VQVAE
from kinema.types import Latents, LatentSpace, MotionBatch

LENGTHS = [40, 23, 9, 4]
SIZE, DIM, LAYERS = 24, 6, 3
QUANTIZERS = {
    "always": lambda: EMACodebook(SIZE, DIM),
    "unused": lambda: EMACodebook(SIZE, DIM, reset="unused"),
    "residual": lambda: ResidualQuantizer(SIZE, DIM, quantizers=LAYERS),
}


def batch(lengths=LENGTHS, seed=0, width=263) -> MotionBatch:
    rows = torch.randn(len(lengths), max(lengths), width, generator=torch.Generator().manual_seed(seed))
    counts = torch.tensor(lengths)
    return MotionBatch(rows * (torch.arange(max(lengths)) < counts[:, None])[..., None], counts)


def make(kind="always", **options) -> VQVAE:
    """Give a tokenizer whose codebooks have seen a few batches, in eval mode."""
    torch.manual_seed(0)
    representation, rng = Representation("redundant", "humanml3d"), np.random.default_rng(0)
    representation.fit(Statistics(rng.normal(size=263), rng.uniform(0.5, 2, 263)))
    sizes = {"codebook_size": SIZE, "code_dim": DIM, "width": 16}
    model = VQVAE(representation, quantizer=QUANTIZERS[kind](), **sizes, **options)
    with torch.no_grad():
        for step in range(3):
            model.loss(batch([32] * 8, step + 50), generator=torch.Generator().manual_seed(step))
    return model.eval()


def rows_of(motion: MotionBatch, indices: list[int], size: int) -> MotionBatch:
    return MotionBatch(motion.features[indices, :size], motion.lengths[indices])


@pytest.mark.parametrize("kind", QUANTIZERS)
def test_codes_and_frames(kind):
    model = make(kind)
    layers = LAYERS if kind == "residual" else 1
    latents = model.encode(batch())
    decoded = model.decode(latents)
    assert isinstance(model, MotionTokenizer)
    assert model.space == LatentSpace("codes", DIM, 49, 4, SIZE, layers)
    assert model.codebooks.shape == (layers, SIZE, DIM)
    assert torch.equal(model.codebook, model.codebooks[0])
    assert latents.codes.shape == (4, 10, layers)
    assert latents.codes.dtype == torch.long
    assert latents.lengths.tolist() == [10, 5, 2, 1]
    assert len(latents.codes[latents.mask].unique()) > 3
    assert not latents.codes[~latents.mask].any()
    assert decoded.features.shape == (4, 40, 263)
    assert decoded.lengths.tolist() == [40, 20, 8, 4]
    assert not decoded.features[~decoded.mask].any()


@pytest.mark.parametrize("kind", QUANTIZERS)
def test_padding_changes_nothing(kind):
    model, motion = make(kind), batch()
    together = model.encode(motion)
    decoded = model.decode(together)
    for i, length in enumerate(LENGTHS):
        latents = model.encode(rows_of(motion, [i], length))
        alone = model.decode(latents)
        assert torch.equal(together.codes[i, : length // 4], latents.codes[0])
        torch.testing.assert_close(decoded.features[i, : length // 4 * 4], alone.features[0], rtol=1e-5, atol=1e-5)


def test_the_order_of_a_batch_changes_nothing():
    model, motion, order = make("residual"), batch(), [2, 0, 3, 1]
    assert torch.equal(model.encode(rows_of(motion, order, 40)).codes, model.encode(motion).codes[order])


def test_what_stands_at_padding_is_not_decoded():
    model = make()
    latents = model.encode(batch())
    expected = model.decode(latents).features
    latents.codes[~latents.mask] = SIZE + 5
    torch.testing.assert_close(model.decode(latents).features, expected, rtol=0, atol=0)


def test_the_published_padding_leaks_into_the_end_of_the_encoder():
    model, motion = make(mask_padding=False), batch()
    alone = model.encoder(model.representation.normalize(motion.features[1:2, :23]))
    padded = model.encoder(model.representation.normalize(motion.features, motion.lengths))
    assert (alone[0] - padded[1, :5]).abs().max() > 1e-3


@pytest.mark.parametrize("kind", QUANTIZERS)
@pytest.mark.parametrize("auxiliary", ["joints", "velocities"])
def test_the_loss_is_its_terms(kind, auxiliary):
    model, motion = (
        make(kind, auxiliary=auxiliary, joint_weight=0.7, commit_weight=0.3, root_weight=2.0),
        batch([16, 16]),
    )
    losses = model.loss(motion)
    assert list(losses) == ["loss", "reconstruction", auxiliary, "commit", "root", "perplexity", "dead_codes"]
    weighted = losses["reconstruction"] + 0.7 * losses[auxiliary] + 0.3 * losses["commit"] + 2 * losses["root"]
    torch.testing.assert_close(losses["loss"], weighted)
    target = model.representation.normalize(motion.features)
    output = model.representation.normalize(model.decode(model.encode(motion)).features)
    columns = {"joints": slice(4, 67), "velocities": slice(193, 259)}[auxiliary]
    for name, part in (("reconstruction", slice(0, 263)), (auxiliary, columns), ("root", slice(0, 4))):
        expected = F.smooth_l1_loss(output[..., part], target[..., part])
        torch.testing.assert_close(losses[name], expected, rtol=1e-4, atol=1e-5)


def test_padding_is_in_no_loss():
    model, motion = make(), batch([40, 20])
    parts = [model.loss(rows_of(motion, [i], n)) for i, n in ((0, 40), (1, 20))]
    losses = model.loss(motion)
    for name in ("reconstruction", "joints", "commit"):
        torch.testing.assert_close(losses[name], (2 * parts[0][name] + parts[1][name]) / 3)


@pytest.mark.parametrize("kind", QUANTIZERS)
def test_every_weight_learns_and_so_does_the_codebook(kind):
    model = make(kind).train()
    before = model.codebooks.clone()
    model.loss(batch([32, 32]), generator=torch.Generator().manual_seed(1))["loss"].backward()
    assert [name for name, p in model.named_parameters() if p.grad is None or not p.grad.any()] == []
    assert not torch.equal(before, model.codebooks)


def test_encoding_teaches_nothing_even_in_training_mode():
    model = make("residual").train()
    before = {k: v.clone() for k, v in model.state_dict().items()}
    model.encode(batch())
    assert model.quantizer.training
    assert all(torch.equal(v, before[k]) for k, v in model.state_dict().items())


class EveryFourth(nn.Module):
    """Stand in for another encoder."""

    def __init__(self) -> None:
        super().__init__()
        self.linear = nn.Linear(263, DIM)

    def forward(self, x, lengths=None):
        return self.linear(x[:, 3::4])


def test_another_encoder_takes_the_place_of_the_convolutions():
    model = make(encoder=EveryFourth())
    assert model.encode(batch()).codes.shape == (4, 10, 1)
    model.train().loss(batch([32, 32]))["loss"].backward()
    assert model.encoder.linear.weight.grad.any()


def test_a_short_run_learns():
    model, motion = make().train(), batch([16] * 2)
    optimizer, losses = torch.optim.AdamW(model.parameters(), 3e-3), []
    for step in range(40):
        loss = model.loss(motion, generator=torch.Generator().manual_seed(step))["loss"]
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < 0.8 * losses[0]


@pytest.mark.parametrize("name", ["vq", "vq_8192", "rvq"])
@pytest.mark.parametrize("scale", ["paper", "tiny", "smoke"])
def test_configs_build(name, scale):
    cfg = compose([f"tokenizer={name}", f"scale={scale}", "representation=published"])
    with torch.device("meta"):
        model = build(plain(cfg.tokenizer.model))
    published = {"vq": (512, 512, 1), "vq_8192": (8192, 32, 1), "rvq": (512, 512, 6)}
    assert scale != "paper" or (model.space.codebook_size, model.space.width, model.space.quantizers) == published[name]
    assert cfg.tokenizer.name == name


def test_what_cannot_work_is_named():
    representation = Representation("essential", "humanml3d")
    with pytest.raises(ValueError, match=r"auxiliary='velocities': choose one of joints$"):
        VQVAE(representation, auxiliary="velocities")
    with pytest.raises(ValueError, match="codebook_size=512, but the quantizer's is 24"):
        VQVAE(representation, quantizer=EMACodebook(SIZE, 512))
    model = make()
    with pytest.raises(ValueError, match="motion of 3 frames is too short"):
        model.encode(batch([3]))
    lengths = torch.tensor([1])
    with pytest.raises(ValueError, match=f"token id {SIZE} is out of range"):
        model.decode(Latents(lengths, 4 * lengths, codes=torch.full((1, 1, 1), SIZE)))
    with pytest.raises(ValueError, match="decodes codes, not continuous values"):
        model.decode(Latents(lengths, 4 * lengths, values=torch.zeros(1, 1, DIM)))

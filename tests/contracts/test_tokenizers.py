"""What every tokenizer option must do: learn, encode, decode, come back from a file, and leave padding out of it."""

from __future__ import annotations

import pytest
import torch

from kinema.experiments.config import CONF
from kinema.runs import weights
from kinema.tokenizers import MotionTokenizer
from kinema.types import MotionBatch

SEVERAL = "vae tokenizer.model.latents=7"  # for reconstruction
TOKENIZERS = [*sorted(file.stem for file in (CONF / "tokenizer").glob("*.yaml")), SEVERAL]
TRAINED = [name for name in TOKENIZERS if name not in ("frames", "frame_groups", "joints")]  # these have no parameter
DIMS = ("essential", "redundant", "published")
PLACED = ("joints", "joint_ae")  # joints are described by essential rows alone
CHOICES = [(name, dims) for name in TRAINED for dims in (DIMS[:1] if name in PLACED else DIMS)]


def parts(workshop, name: str, dims: str | None = None):
    dims = dims or ("essential" if name in PLACED else "published")
    if name == "fsq":
        pytest.importorskip("vector_quantize_pytorch", reason="needs the extra kinema[vq]")
    return workshop.tokenizer(*choice(name, dims))


def choice(name: str, dims: str) -> list[str]:
    return [f"tokenizer={name.split()[0]}", *name.split()[1:], f"representation={dims}"]


@pytest.mark.parametrize(("name", "dims"), CHOICES)
def test_one_step_has_a_finite_loss_and_a_gradient_in_every_parameter(workshop, name, dims):
    parts(workshop, name, dims)
    model = workshop.make("tokenizer", *choice(name, dims)).train()
    losses = model.loss(workshop.windows(), generator=torch.Generator().manual_seed(0))
    assert next(iter(losses)) == "loss"
    assert all(value.isfinite() for value in losses.values())
    losses["loss"].backward()
    lacking = [n for n, p in model.named_parameters() if p.requires_grad and (p.grad is None or not p.grad.any())]
    assert not lacking


@pytest.mark.parametrize("name", TOKENIZERS)
def test_it_decodes_what_it_encodes_and_padding_changes_nothing(workshop, name):
    model = parts(workshop, name)
    assert isinstance(model, MotionTokenizer)
    batch = workshop.clips()
    latents = model.encode(batch)
    decoded = model.decode(latents)
    assert torch.equal(latents.lengths, model.space.latents_of(batch.lengths))
    assert torch.equal(decoded.lengths, latents.frames)
    assert decoded.features.shape[2] == model.representation.width
    assert not decoded.features[~decoded.mask].any()
    row = int(batch.lengths.argmin())
    frames = int(batch.lengths[row])
    alone = MotionBatch(batch.features[row : row + 1, :frames], batch.lengths[row : row + 1])
    own = model.encode(alone)
    if latents.codes is None:
        torch.testing.assert_close(own.values[0], latents.values[row, : own.values.shape[1]], rtol=1e-4, atol=1e-4)
    else:
        assert latents.codes.shape[2] == model.space.quantizers
        assert not latents.codes[~latents.mask].any()
        assert int(latents.codes.max()) < model.space.codebook_size
        assert torch.equal(own.codes[0], latents.codes[row, : own.codes.shape[1]])
    same = model.decode(own).features[0]
    torch.testing.assert_close(same, decoded.features[row, : len(same)], rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("name", TOKENIZERS)
def test_it_comes_back_from_a_file(workshop, name, tmp_path):
    model = parts(workshop, name)
    path = weights.save(model, model.spec, tmp_path / "weights.safetensors")
    loaded, _ = weights.load(path)
    batch = workshop.clips()
    ours, theirs = (m.decode(m.encode(batch)).features for m in (model, loaded))
    assert torch.equal(ours, theirs)

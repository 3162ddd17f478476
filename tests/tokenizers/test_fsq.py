"""Finite scalar quantisation speaks the quantisers' protocol: codes and vectors name each other, nothing dies."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import torch

from kinema.experiments.config import compose, plain
from kinema.motion.representation import Representation
from kinema.motion.statistics import Statistics
from kinema.runs.build import build
from kinema.tokenizers.fsq import FiniteScalarQuantizer
from kinema.tokenizers.vq import VQVAE
from kinema.types import Latents, MotionBatch

pytest.importorskip("vector_quantize_pytorch")


def make(levels=(5, 4, 3), code_dim=8) -> FiniteScalarQuantizer:
    torch.manual_seed(0)
    return FiniteScalarQuantizer(levels, code_dim)


def vectors(*size: int, seed: int = 0) -> torch.Tensor:
    return 3 * torch.randn(*size, generator=torch.Generator().manual_seed(seed))


def tokenizer() -> VQVAE:
    torch.manual_seed(0)
    representation = Representation("essential", "humanml3d").fit(Statistics(np.zeros(67), np.ones(67)))
    return VQVAE(representation, codebook_size=60, code_dim=8, quantizer=make(), width=16, commit_weight=0.0)


def motion(lengths=(32, 32, 17), seed=0) -> MotionBatch:
    rows = torch.randn(len(lengths), 32, 67, generator=torch.Generator().manual_seed(seed))
    return MotionBatch(rows, torch.tensor(lengths))


def test_its_codes_are_all_combinations_of_levels():
    quantizer = make()
    codebook = quantizer.codebook
    assert codebook.shape == (quantizer.codebook_size, quantizer.code_dim) == (60, 8)
    assert len(codebook.unique(dim=0)) == 60
    # Each combination, sent through the rounding alone, is itself.
    points = quantizer.fsq.implicit_codebook
    for column, count in enumerate((5, 4, 3)):
        assert len(points[:, column].unique()) == count


def test_values_are_the_vectors_of_their_codes():
    quantizer = make()
    real = torch.arange(20) < torch.tensor([[20], [7]])
    quantized = quantizer(vectors(2, 20, 8), real)
    found = quantizer.lookup(quantized.codes)
    torch.testing.assert_close(quantized.values[real], found[real])
    assert not quantized.values[~real].any()
    assert not quantized.codes[~real].any()
    assert quantized.codes.dtype == torch.long
    assert quantized.commit == 0
    counts = torch.bincount(quantized.codes[real].flatten(), minlength=60).double()
    share = counts[counts > 0] / counts.sum()
    assert quantized.perplexity.item() == pytest.approx(float(torch.exp(-(share * share.log()).sum())), rel=1e-4)


def test_lookup_of_no_code_and_of_a_wrong_one():
    quantizer = make()
    assert not quantizer.lookup(torch.tensor([[[-1]]])).any()
    with pytest.raises(ValueError, match="token id 60 is out of range; this codebook has the ids 0 to 59"):
        quantizer.lookup(torch.tensor([[[60]]]))


def test_dead_codes_follow_what_is_chosen():
    quantizer, real = make().train(), torch.ones(1, 200, dtype=torch.bool)
    for step in range(300):
        quantized = quantizer(torch.zeros(1, 200, 8), real)
        if step == 0:
            assert quantized.dead_codes == pytest.approx(59 / 60)
    assert quantizer.counts.argmax() == quantized.codes[0, 0, 0]
    before = quantizer.counts.clone()
    quantizer.eval()(vectors(1, 200, 8), real)
    assert torch.equal(quantizer.counts, before)


def test_a_tokenizer_learns_and_its_weights_hold_all_it_knows():
    model = tokenizer().train()
    with torch.no_grad():
        model.encoder.head.weight.mul_(20)  # an untrained encoder's vectors all round to zero
    model.loss(motion())["loss"].backward()
    assert [name for name, p in model.named_parameters() if p.grad is None or not p.grad.any()] == []
    model.eval()
    latents = model.encode(motion())
    assert latents.codes.shape == (3, 8, 1)
    assert not latents.codes[2, 4:].any()
    again = tokenizer()
    again.load_state_dict(model.state_dict())
    assert torch.equal(again.eval().encode(motion()).codes, latents.codes)
    torch.testing.assert_close(again.decode(latents).features, model.decode(latents).features)


def test_padding_changes_nothing():
    model = tokenizer().eval()
    together = model.encode(motion()).codes[2, :4]
    alone = model.encode(MotionBatch(motion().features[2:, :17], torch.tensor([17]))).codes[0]
    assert torch.equal(together, alone)
    with pytest.raises(ValueError, match="token id 99 is out of range"):
        model.decode(Latents(torch.tensor([1]), torch.tensor([4]), codes=torch.full((1, 1, 1), 99)))


@pytest.mark.parametrize("scale", ["paper", "tiny", "smoke"])
def test_the_config_has_about_as_many_codes_as_vq(scale):
    sizes = {}
    for name in ("vq", "fsq"):
        spec = plain(compose(["stage=tokenizer", f"tokenizer={name}", f"scale={scale}"]).tokenizer.model)
        sizes[name] = spec["codebook_size"]
        if scale != "paper":
            assert build(spec).quantizer.codebook_size == sizes[name]
    assert sizes["fsq"] == pytest.approx(sizes["vq"], rel=0.1)


def test_bad_input_is_named(monkeypatch):
    for levels in ([], [8, 2], [0]):
        with pytest.raises(ValueError, match=r"levels=.*: must be a list of at least 1, each a whole number from 3"):
            make(levels)
    with pytest.raises(ValueError, match="codebook_size=64, but the quantizer's is 60"):
        VQVAE(Representation("essential", "humanml3d"), codebook_size=64, code_dim=8, quantizer=make())
    monkeypatch.setitem(sys.modules, "vector_quantize_pytorch", None)
    with pytest.raises(ImportError, match=r"pip install 'kinema\[vq\]'"):
        make()

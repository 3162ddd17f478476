"""Codes are counted once each, padding never, however they arrive."""

from __future__ import annotations

import math
from collections import Counter

import pytest
import torch

from kinema.evaluation.metrics.code_usage import CodeUsage
from kinema.types import Latents


def latents(codes: torch.Tensor, lengths: list[int]) -> Latents:
    counts = torch.tensor(lengths)
    return Latents(counts, 4 * counts, codes=codes)


def draw(lengths=(9, 4, 0, 7), size=12, quantizers=3, seed=0) -> Latents:
    shape = (len(lengths), max(lengths), quantizers)
    codes = torch.randint(size, shape, generator=torch.Generator().manual_seed(seed))
    return latents(torch.minimum(codes, codes.flip(-1)), list(lengths))


def measure(*batches: Latents, size=12) -> dict:
    metric = CodeUsage(size, batches[0].codes.shape[-1])
    for batch in batches:
        metric.update(batch)
    return metric.compute()


def test_counts_are_those_of_a_loop():
    batch = draw()
    result = measure(batch)
    for layer in range(3):
        rows = zip(batch.codes.tolist(), batch.lengths.tolist(), strict=True)
        seen = Counter(row[layer] for codes, n in rows for row in codes[:n])
        shares = [n / 20 for n in seen.values()]
        assert result["histogram"][layer].tolist() == sorted((seen[k] for k in range(12)), reverse=True)
        assert result["layer_used"][layer] == len(seen) == 12 - result["layer_dead"][layer]
        entropy = -sum(share * math.log(share) for share in shares)
        assert result["layer_perplexity"][layer].item() == pytest.approx(math.exp(entropy), rel=1e-5)
    for name in ("perplexity", "used", "dead"):
        assert result[name].item() == pytest.approx(result[f"layer_{name}"].float().mean().item())


def test_padding_and_layers_left_out_are_not_counted():
    batch = draw()
    before = measure(batch)
    batch.codes[~batch.mask] = 5
    after = measure(batch)
    assert torch.equal(before["histogram"], after["histogram"])
    batch.codes[..., 1:] = -1
    alone = measure(batch)
    assert torch.equal(alone["histogram"][0], before["histogram"][0])
    assert not alone["histogram"][1:].any()
    assert alone["layer_perplexity"][1:].tolist() == [0, 0]
    assert alone["layer_dead"][1:].tolist() == [12, 12]


def test_an_even_use_has_the_perplexity_of_the_codebook():
    codes = torch.arange(12).repeat(5)[None, :, None]
    result = measure(latents(codes, [60]))
    assert result["perplexity"].item() == pytest.approx(12, rel=1e-5)
    assert measure(latents(torch.full((1, 9, 1), 3), [9]))["perplexity"].item() == pytest.approx(1)


def test_batches_and_processes_add_up():
    parts = [draw(seed=1), draw((3, 8), seed=2)]
    whole = measure(*parts)
    metrics = [CodeUsage(12, 3) for _ in parts]
    for metric, part in zip(metrics, parts, strict=True):
        metric.update(part)
    metrics[0].merge_state(metrics[1])
    merged = metrics[0].compute()
    assert all(torch.equal(whole[name], merged[name]) for name in whole)
    metrics[0].reset()
    assert not metrics[0].counts.any()


def test_bad_codes_are_named():
    with pytest.raises(ValueError, match="3 codes per position, this metric counts 1"):
        CodeUsage(12).update(draw())
    with pytest.raises(ValueError, match="continuous values"):
        CodeUsage(12).update(Latents(torch.tensor([1]), torch.tensor([4]), values=torch.zeros(1, 1, 8)))
    with pytest.raises(ValueError, match="code 11 is out of range: codebook_size=11"):
        CodeUsage(11).update(latents(torch.full((1, 2, 1), 11), [2]))

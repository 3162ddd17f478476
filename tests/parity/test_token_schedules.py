"""Compare the schedules of masked tokens with those of the published MMM, BAD and MoMask, for lengths 1 to 49."""

from __future__ import annotations

import pytest
import torch
from safetensors.torch import load_file

from kinema.masking import cosine_counts, shrinking_counts


def test_mmm_and_bad(golden_file):
    golden = load_file(golden_file("vq/schedules.safetensors"))
    counts = shrinking_counts(golden["in.tokens_len"], 10)
    assert torch.equal(counts.T, golden["out.bad_mmm_masked"])


@pytest.mark.parametrize("steps", [10, 18])
def test_momask(golden_file, steps):
    golden = load_file(golden_file("vq/schedules.safetensors"))
    counts = cosine_counts(golden["in.tokens_len"], steps)
    assert torch.equal(counts.T, golden[f"out.momask_masked_{steps}"])

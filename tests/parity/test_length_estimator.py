"""Compare the length estimator with the published one."""

from __future__ import annotations

import pytest
import torch
from safetensors.torch import load_file

from kinema import interop

pytestmark = pytest.mark.shared


def test_logits_and_probabilities(golden_file):
    golden = load_file(golden_file("mardm/mardm_length_estimator.safetensors"))
    state = {k.removeprefix("sd."): v for k, v in golden.items() if k.startswith("sd.")}
    logits = interop.load("length-estimator", {"estimator": state})(golden["in.text"])
    torch.testing.assert_close(logits, golden["out.logits"], rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(logits.softmax(dim=1), golden["out.probs"], rtol=1e-4, atol=1e-5)

"""Test the switch to inference."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from kinema.nn.mode import inference


@pytest.mark.parametrize("training", [True, False])
def test_mode_comes_back_even_after_an_error(training):
    module = nn.Sequential(nn.Dropout()).train(training)
    seen = []

    def fail() -> None:
        with inference(module):
            seen.append((module[0].training, torch.is_grad_enabled()))
            raise RuntimeError("inside")

    with pytest.raises(RuntimeError, match="inside"):
        fail()
    assert seen == [(False, False)]
    assert module[0].training == training
    assert torch.is_grad_enabled()

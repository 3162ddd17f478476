"""Test the diffusion MLP."""

from __future__ import annotations

import pytest
import torch

from kinema.nn.diffusion_mlp import DiffusionMLP


@pytest.fixture
def mlp():
    torch.manual_seed(0)
    return DiffusionMLP(latent_dim=5, condition_dim=7, width=12, depth=2)


def randomise(mlp):
    for parameter in mlp.parameters():
        torch.nn.init.normal_(parameter, std=0.3)


def test_untrained_output_is_zero(mlp):
    assert not mlp(torch.randn(4, 5), torch.rand(4), torch.randn(4, 7)).any()


def test_rows_do_not_see_each_other(mlp):
    randomise(mlp)
    x, t, c = torch.randn(4, 5), torch.rand(4) * 50, torch.randn(4, 7)
    torch.testing.assert_close(mlp(x, t, c)[2:3], mlp(x[2:3], t[2:3], c[2:3]))


def test_one_time_serves_all_rows(mlp):
    randomise(mlp)
    x, c = torch.randn(4, 5), torch.randn(4, 7)
    torch.testing.assert_close(mlp(x, torch.tensor(3.0), c), mlp(x, torch.full((4,), 3.0), c))


def test_published_size_has_the_published_number_of_parameters():
    with torch.device("meta"):
        mlp = DiffusionMLP(512, 1024)
    assert sum(p.numel() for p in mlp.parameters()) == 270_875_648

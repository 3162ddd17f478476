"""Every step follows the recipe: its averages, its optimiser, its clipping and its draws."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import torch
from lightning.pytorch import Trainer
from torch import nn
from torch.utils.data import DataLoader

from kinema.training.callbacks import EMA
from kinema.training.modules import MotionModule
from kinema.training.recipe import Recipe
from kinema.types import MotionBatch


@pytest.mark.parametrize(
    ("ema", "count", "expected"), [(EMA(0.9, warmup=False), 5, 0.9), (EMA(0.9), 0, 0.1), (EMA(0.9), 10**6, 0.9)]
)
def test_the_average_is_the_published_one(ema, count, expected):
    averages = [torch.ones(2), torch.ones(3, 1)]
    ema._average(averages, [torch.zeros(2), torch.zeros(3, 1)], count)
    for average in averages:
        torch.testing.assert_close(average, torch.full_like(average, expected))


def test_the_optimiser_has_the_recipes_numbers():
    recipe = Recipe(10, 1, lr=0.5, betas=(0.8, 0.95), weight_decay=0.3)
    (group,) = recipe.optimizer([nn.Parameter(torch.zeros(1))]).param_groups
    assert (group["lr"], group["betas"], group["weight_decay"]) == (0.5, (0.8, 0.95), 0.3)


@pytest.mark.parametrize(("each", "norms"), [((), (0.6, 0.8)), (("a", "b"), (1.0, 1.0))])
def test_gradients_are_clipped_together_or_each_part_by_itself(each, norms, monkeypatch):
    monkeypatch.setattr(MotionModule, "trainer", SimpleNamespace(log_every_n_steps=1000))
    model = nn.ModuleDict({name: nn.Linear(1, 1, bias=False) for name in "ab"})
    module = MotionModule(model, Recipe(10, 1, clip=1.0, clip_each=each), 0)
    for name, value in (("a", 3.0), ("b", 4.0)):
        model[name].weight.grad = torch.full((1, 1), value)
    module.configure_gradient_clipping(module.recipe.optimizer(model.parameters()))
    assert [model[name].weight.grad.norm().item() for name in "ab"] == pytest.approx(norms, rel=1e-4)


def test_every_step_draws_anew():
    seen = []

    class Drawn(nn.Module):
        def __init__(self):
            super().__init__()
            self.weight = nn.Parameter(torch.zeros(()))

        def loss(self, batch, *, generator, shard):
            seen.append(torch.rand((), generator=generator).item())
            return {"loss": self.weight + 0}

    batch = MotionBatch(torch.zeros(1, 4, 67), torch.tensor([4]))
    quiet = {"logger": False, "enable_checkpointing": False, "enable_progress_bar": False}
    Trainer(max_steps=3, accelerator="cpu", enable_model_summary=False, **quiet).fit(
        MotionModule(Drawn(), Recipe(3, 1), 0), DataLoader([0, 1, 2], collate_fn=lambda _: batch)
    )
    assert len(set(seen)) == 3

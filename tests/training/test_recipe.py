"""Check the learning-rate schedules against the published loops, and the refusal of wrong values."""

from itertools import pairwise

import pytest
import torch
from safetensors.torch import load_file

from kinema.experiments.training import Budget
from kinema.training.recipe import Recipe


@pytest.mark.parametrize(
    ("key", "counted", "gamma"),
    [("lr_ae_warm20_milestone30", "warmup_end", 0.05), ("lr_mardm_warm20_milestone30", "start", 0.1)],
)
def test_schedule_is_the_published_one(golden_file, key: str, counted: str, gamma: float):
    golden = load_file(golden_file("mardm/mardm_schedules.safetensors"))[key]
    recipe = Recipe(100, 1, warmup=20, milestones=(30,), milestones_from=counted, gamma=gamma)
    ours = torch.tensor([recipe.lr * recipe.factor(step) for step in range(len(golden))], dtype=torch.float64)
    torch.testing.assert_close(ours, golden, rtol=1e-6, atol=0)


def test_warmup_of_two_thousand_steps(golden_file):
    golden = load_file(golden_file("mardm/mardm_schedules.safetensors"))["lr_warmup_2000_first5"]
    recipe = Recipe(5000, 1, warmup=2000)
    ours = [recipe.lr * recipe.factor(step) for step in range(5)]
    torch.testing.assert_close(torch.tensor(ours, dtype=torch.float64), golden, rtol=1e-6, atol=0)


def test_cosine_decay_ends_at_a_hundredth():
    recipe = Recipe(200, 1, warmup=10, decay="cosine")
    factors = [recipe.factor(step) for step in range(201)]
    assert factors[0] < factors[5] < factors[9]
    assert factors[200] == pytest.approx(0.01 * 10 / 11, rel=1e-4)
    assert all(a >= b for a, b in pairwise(factors[10:]))


@pytest.mark.parametrize(
    ("wrong", "named"),
    [({"decay": "linear"}, "cosine"), ({"select": "first"}, "best"), ({"milestones_from": "end"}, "warmup_end")],
)
def test_wrong_choices_name_what_is_allowed(wrong: dict, named: str):
    with pytest.raises(ValueError, match=named):
        Recipe(10, 1, **wrong)


def test_steps_must_be_positive():
    with pytest.raises(ValueError, match="steps"):
        Recipe(0, 1)


@pytest.mark.parametrize(
    ("epochs", "repeats", "items", "steps"),
    [(50, 200, 4472, 43_650), (10_000, 1, 4472, 40_000), (3, 1, 9, 3), (40, 200, 23_384, 182_680)],
)
def test_what_a_batch_leaves_over_is_lost_once_an_epoch(epochs, repeats, items, steps):
    """MotionDiffuse: the corpus is repeated first and divided into batches then."""
    assert Budget("clips", 1024, epochs=epochs, repeats=repeats).steps_of(items) == steps


def test_steps_come_before_epochs():
    assert Budget("clips", 64, steps=7, epochs=3).steps_of(1000) == 7
    with pytest.raises(ValueError, match=r"x\.steps and x\.epochs are both empty"):
        Budget("clips", 64).steps_of(1000, "x")

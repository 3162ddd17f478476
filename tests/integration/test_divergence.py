"""A number that is not finite ends a training at once: nothing of it is saved, and the checkpoint of before stays."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from kinema.experiments.config import compose
from kinema.experiments.run import run_stage
from kinema.runs.folder import RunFolder
from kinema.training.callbacks import RunRecord
from kinema.training.divergence import DivergedError, FirstLoss
from kinema.training.modules import MotionModule


def poison_losses(monkeypatch, kind: str, step: int, value: float) -> None:
    losses = MotionModule.losses

    def poisoned(self, *arguments):
        found = losses(self, *arguments)
        if self.trainer.training == (kind == "training") and self.global_step + (kind == "training") == step:
            found["loss"] = found["loss"] * value
        return found

    monkeypatch.setattr(MotionModule, "losses", poisoned)


def poison_weights(monkeypatch, step: int) -> None:
    """As an optimiser does whose gradients overflow: the loss of the step itself is finite."""

    def poisoned(self, trainer, module, *_):
        if trainer.global_step == step:
            with torch.no_grad():
                next(module.model.parameters()).fill_(float("inf"))

    monkeypatch.setattr(RunRecord, "on_train_batch_end", poisoned)


@pytest.mark.parametrize("select", ["best", "last"])
@pytest.mark.parametrize(
    ("kind", "step", "value", "told", "kept"),
    [
        ("training", 13, float("nan"), "at step 13 the training loss is nan", 10),
        ("training", 15, float("inf"), "at step 15 the training loss is inf", 10),
        ("validation", 16, float("nan"), "at step 16 the validation loss is nan", 15),
        ("weights", 15, 0.0, r"at step 15 \S+ is not finite", 10),
        ("weights", 24, 0.0, r"at step 24 the validation loss is nan|at step 24 \S+ is not finite", 20),
        ("training", 1, float("nan"), "at step 1 the training loss is nan", None),
    ],
)
def test_the_first_number_that_is_not_finite_ends_it(kind, step, value, told, kept, select, overrides, monkeypatch):
    own = compose([*overrides, f"tokenizer.train.select={select}"])
    if kind == "weights":
        poison_weights(monkeypatch, step)
    else:
        poison_losses(monkeypatch, kind, step, value)
    with pytest.raises(ValueError, match=rf"^training diverged: ({told}); lower train\.lr, .*") as caught:
        run_stage(own, "tokenizer")
    (folder,) = Path(own.paths.runs).glob("tokenizer/*")
    checkpoint = folder / "checkpoints" / "last.ckpt"
    assert not RunFolder(folder).weights.exists()
    assert RunFolder(folder).status["state"] == "failed"
    if kept is None:
        assert not checkpoint.exists()
        assert "kept" not in str(caught.value)
        return
    saved = torch.load(checkpoint, weights_only=True)
    assert saved["global_step"] == kept
    assert all(value.isfinite().all() for value in saved["state_dict"].values())
    assert str(caught.value).endswith(f"the checkpoint of step {kept} is kept, {checkpoint}")


def test_no_step_waits_for_its_loss(monkeypatch, overrides):
    """The losses are looked at where something is recorded, saved or validated; a late look names the first bad one."""
    seen: list[int] = []
    check = FirstLoss.check
    monkeypatch.setattr(FirstLoss, "check", lambda self, gather: seen.append(1) or check(self, gather))
    run_stage(compose(overrides), "tokenizer")  # 24 steps; saved every 5, validated every 8, recorded every 50
    assert len(seen) < 24


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf")])
def test_the_first_of_all_ranks_is_named(bad):
    first = FirstLoss()
    for step, loss in enumerate([1.0, bad, 2.0, float("nan")], 1):
        first.see(torch.tensor(loss, requires_grad=True), step)
    with pytest.raises(DivergedError, match=f"at step 2 the training loss is {bad}"):
        first.check(lambda number: number)
    sound = FirstLoss()
    sound.check(lambda number: number)
    sound.see(torch.tensor(1.0), 1)
    sound.check(lambda number: number)
    others = iter([torch.tensor([0, 7, 3]), torch.tensor([0.0, bad, bad])])
    with pytest.raises(DivergedError, match="at step 3"):  # another rank's
        sound.check(lambda _: next(others))


def test_an_error_behind_a_bad_loss_is_told_as_that(overrides, monkeypatch):
    """What a model does with numbers that are not finite may be an error of its own, long before the next look."""
    poison_losses(monkeypatch, "training", 2, float("nan"))
    losses = MotionModule.losses

    def failing(self, *arguments):
        if self.trainer.training and self.global_step == 2:
            raise RuntimeError("probability tensor contains nan")
        return losses(self, *arguments)

    monkeypatch.setattr(MotionModule, "losses", failing)
    with pytest.raises(ValueError, match=r"^training diverged: at step 2 the training loss is nan"):
        run_stage(compose(overrides), "tokenizer")

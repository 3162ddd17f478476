"""Train on two processes (gloo): the losses and weights of one process at the same global batch."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from kinema.experiments.config import compose, refuse_processes
from kinema.experiments.run import run_stage

STAGE_NODE = {"tokenizer": "tokenizer", "generator": "generator", "matching": "evaluator.matching"}
UPSTREAM = {"generator": "tokenizer", "matching": "decomposition"}


def validation_losses(run: Path) -> list[float]:
    lines = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    return [line["val/loss"] for line in lines if "val/loss" in line]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stage", "method"),
    [
        ("generator", []),
        ("matching", []),
        ("tokenizer", ["method=momask"]),  # codebooks that learn from all ranks, one number of active layers
        ("generator", ["method=bad_oaas"]),  # one coin per batch
    ],
)
def test_two_processes_train_like_one(stage, method, overrides, script, tmp_path: Path):
    # Dropout draws differ between ranks by nature; everything else is drawn for the global batch.
    overrides = [*overrides, *method]
    same = [*overrides, "generator.model.dropout=0", f"{STAGE_NODE[stage]}.train.val_batches=2"]
    alone = run_stage(compose([*same, f"paths.runs={tmp_path}/alone"]), stage)
    # What comes before was trained with dropout: on one process here, so that both start from the same.
    if stage in UPSTREAM:
        run_stage(compose([*same, f"paths.runs={tmp_path}/two"]), UPSTREAM[stage])
    two = ["trainer.devices=2", "trainer.strategy=ddp", f"paths.runs={tmp_path}/two", f"stage={stage}"]
    script("train.py", *method, *same[len(overrides) :], *two)
    (together,) = (tmp_path / "two" / stage).iterdir()
    assert together.name == alone.path.name
    assert validation_losses(together) == pytest.approx(validation_losses(alone.path), rel=1e-3)
    ours, theirs = load_file(together / "weights.safetensors"), load_file(alone.weights)
    for name, value in theirs.items():
        torch.testing.assert_close(ours[name], value, rtol=1e-2, atol=1e-4, msg=name)


@pytest.mark.parametrize("options", [["trainer=ddp"], ["trainer.devices=2"], ["trainer.num_nodes=2"]])
def test_several_processes_inside_a_sweep_are_refused(options, monkeypatch):
    monkeypatch.setenv("RANK", "0")
    with pytest.raises(ValueError, match="one run at a time"):
        refuse_processes(compose(options), multirun=True)
    refuse_processes(compose(options), multirun=False)
    refuse_processes(compose(["trainer.devices=[0]"]), multirun=True)


def test_nodes_that_nothing_numbers_are_refused(monkeypatch):
    """Two that take themselves for the first would wait for each other, or write one run."""
    for name in ("RANK", "SLURM_PROCID"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(ValueError, match=r"trainer.num_nodes=2: nothing tells .*start it by torchrun"):
        refuse_processes(compose(["trainer.num_nodes=2"]), multirun=False)
    monkeypatch.setenv("SLURM_PROCID", "1")
    refuse_processes(compose(["trainer.num_nodes=2"]), multirun=False)


def test_spawned_processes_are_refused():
    with pytest.raises(ValueError, match="strategy=ddp"):
        refuse_processes(compose(["trainer.strategy=ddp_spawn"]), multirun=False)

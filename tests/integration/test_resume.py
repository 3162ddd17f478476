"""Kill training with SIGKILL and call it again: the weights are those of an uninterrupted run, bit for bit."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from kinema.experiments.config import compose
from kinema.experiments.run import run_stage

KILLER = """
import os, signal, sys
from kinema.training import fit as fitting

STEP, WHEN = int(os.environ["KILL_AT"]), os.environ["KILL_WHEN"]

class Dying(fitting.Checkpoints):
    def on_train_batch_end(self, trainer, *rest):
        super().on_train_batch_end(trainer, *rest)
        self.die(trainer, "batch")

    def on_validation_end(self, trainer, module):
        self.die(trainer, "validated")
        super().on_validation_end(trainer, module)
        self.die(trainer, "saved")

    def die(self, trainer, when):
        if (STEP, WHEN) == (trainer.global_step, when):
            os.kill(os.getpid(), signal.SIGKILL)

fitting.Checkpoints = Dying
from kinema.experiments.config import compose
from kinema.experiments.run import run_stage
cfg = compose(sys.argv[1:])
run_stage(cfg, cfg.stage)
"""
"""Dies by SIGKILL at step KILL_AT: after the batch, after its validation, or after the checkpoint of that."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stage", "deaths", "method"),
    [
        ("matching", [(11, "batch"), (16, "validated")], []),
        ("generator", [(16, "batch"), (16, "saved")], []),
        ("tokenizer", [(11, "batch")], ["method=momask"]),  # the codebooks' sums and counts too
    ],
)
def test_killed_run_ends_with_the_same_weights(stage, deaths, method, overrides, script, tmp_path: Path, monkeypatch):
    overrides = [*overrides, *method]
    straight = run_stage(compose([*overrides, f"paths.runs={tmp_path}/straight"]), stage)
    killer = tmp_path / "killer.py"
    killer.write_text(KILLER)
    before = {"matching": "decomposition", "generator": "tokenizer"}.get(stage)
    if before:
        run_stage(compose(overrides), before)
    for step, when in deaths:
        monkeypatch.setenv("KILL_AT", str(step))
        monkeypatch.setenv("KILL_WHEN", when)
        assert script(str(killer), f"stage={stage}", *method, check=False).returncode == -signal.SIGKILL
    resumed = run_stage(compose(overrides), stage)
    assert resumed.path.name == straight.path.name
    ours, theirs = load_file(resumed.weights), load_file(straight.weights)
    assert ours.keys() == theirs.keys()
    for name, value in theirs.items():
        assert torch.equal(ours[name], value), name
    validations = [x for x in (resumed.path / "metrics.jsonl").read_text().splitlines() if '"val/loss"' in x]
    assert [json.loads(x)["step"] for x in validations] == [8, 16, 24]

"""Give an imported run, and check that an error is one line."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from kinema import cli


def published_autoencoder() -> dict[str, torch.Tensor]:
    """Give a tiny MARDM autoencoder under its published names."""
    generator, state = torch.Generator().manual_seed(0), {}

    def conv(name, outputs, inputs, size):
        state[f"{name}.weight"] = 0.2 * torch.randn(outputs, inputs, size, generator=generator)
        state[f"{name}.bias"] = 0.2 * torch.randn(outputs, generator=generator)

    def blocks(name):
        for i in range(3):
            conv(f"{name}.model.{i}.conv1", 8, 8, 3)
            conv(f"{name}.model.{i}.conv2", 8, 8, 1)

    conv("encoder.model.0", 8, 67, 3)
    conv("decoder.model.0", 8, 6, 3)
    for level in (2, 3):
        conv(f"encoder.model.{level}.0", 8, 8, 4)
        blocks(f"encoder.model.{level}.1")
        blocks(f"decoder.model.{level}.0")
        conv(f"decoder.model.{level}.2", 8, 8, 3)
    conv("encoder.model.4", 6, 8, 3)
    conv("decoder.model.4", 8, 8, 3)
    conv("decoder.model.6", 67, 8, 3)
    return state


def published_generator() -> dict[str, torch.Tensor]:
    """Give a tiny MARDM under its published names."""
    from kinema.interop.mardm import export as published
    from kinema.runs.build import build

    torch.manual_seed(0)
    sizes = {
        "latent_dim": 6,
        "text_dim": 64,
        "width": 16,
        "feedforward": 32,
        "heads": 2,
        "mlp_width": 16,
        "mlp_depth": 2,
    }
    mlp = {"mlp_width": 16, "mlp_depth": 2}
    flow = {"_target_": "kinema.diffusion.flow.Flow"}
    return published(build({"_target_": "kinema.generators.mar.MARDM", "process": flow, **sizes, **mlp}))


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Give the folder of an imported generator, with its imported autoencoder beside it."""
    monkeypatch.chdir(tmp_path)
    np.save("Mean.npy", np.zeros(67))
    np.save("Std.npy", np.full(67, 0.1))
    torch.save({"ae": published_autoencoder(), "ep": 50}, "ae.tar")
    torch.save({"ema_mardm": published_generator(), "mardm": {}, "ep": 3}, "mardm.tar")
    assert cli.main(["import", "mardm-ae", "ae.tar", "--out", "runs/ae", "--statistics", "."]) == 0
    arguments = ["import", "mardm", "mardm.tar", "--out", "runs/mar", "--tokenizer", "runs/ae", "--text", "hashed"]
    assert cli.main([*arguments, "--set", "variant=sit", "--set", "heads=2"]) == 0
    return tmp_path / "runs" / "mar"


FAST = ["--set", "steps=2", "--set", "solver=euler", "--set", "solver_steps=2"]


def fails(capsys, arguments, *messages):
    capsys.readouterr()
    assert cli.main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("error: ")
    assert captured.err.count("\n") == 1
    for message in messages:
        assert message in captured.err

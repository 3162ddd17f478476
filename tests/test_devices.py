from __future__ import annotations

import pytest
import torch

from kinema.devices import find_device, global_rank
from kinema.training.machine import Machine


def test_names_stand_for_the_first_device_that_is_there(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(torch.backends.mps, "is_available", lambda: False)
    assert {find_device(name) for name in (None, "auto", "cpu", torch.device("cpu"))} == {torch.device("cpu")}
    for name in ("gpu", "cuda", "mps"):
        with pytest.raises(ValueError, match=rf"device '{name}' cannot be used here \(there is none\); choose cpu"):
            find_device(name)
    monkeypatch.setattr(torch.backends.mps, "is_available", lambda: True)
    assert find_device() == find_device("gpu") == torch.device("mps")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert find_device() == find_device("gpu") == torch.device("cuda")


def test_what_torch_does_not_know_is_named():
    with pytest.raises(ValueError, match=r"device 'tpux' cannot be used here \(.*tpux.*\); choose"):
        find_device("tpux")


@pytest.mark.parametrize(
    ("environment", "rank"),
    [({}, 0), ({"LOCAL_RANK": "1"}, 1), ({"RANK": "5", "LOCAL_RANK": "1"}, 5), ({"SLURM_PROCID": ""}, 0)],
)
def test_rank_is_what_the_launcher_set(environment, rank, monkeypatch):
    for name in ("RANK", "LOCAL_RANK", "SLURM_PROCID"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert global_rank() == rank


@pytest.mark.parametrize(
    ("devices", "place", "number"),
    [
        (1, {}, 0),
        (1, {"SLURM_LOCALID": "2"}, 0),  # four tasks of a node, each a training of its own
        ("auto", {"LOCAL_RANK": "2"}, 2),
        (-1, {"SLURM_LOCALID": "3", "SLURM_PROCID": "7"}, 3),
        ("2", {"LOCAL_RANK": "1"}, 1),
        ([1], {}, 1),
        ("1,3", {"LOCAL_RANK": "1", "RANK": "5"}, 3),
    ],
)
def test_what_helps_a_process_is_on_the_device_that_lightning_gives_it(devices, place, number, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 4)
    for name in ("RANK", "LOCAL_RANK", "SLURM_PROCID", "SLURM_LOCALID"):
        monkeypatch.delenv(name, raising=False)
    for name, value in place.items():
        monkeypatch.setenv(name, value)
    assert Machine(accelerator="gpu", devices=devices).device() == torch.device("cuda", number)

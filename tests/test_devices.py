from __future__ import annotations

import pytest
import torch

from kinema.devices import find_device, global_rank


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

"""Find what this process computes on: its device, and its place among the processes of a run."""

from __future__ import annotations

import os

import torch

ACCELERATORS = {
    "auto": ("cuda", "mps", "cpu"),
    "gpu": ("cuda", "mps"),
    "cuda": ("cuda",),
    "mps": ("mps",),
    "cpu": ("cpu",),
}
"""What a name stands for: the first of these that is there."""


def find_device(name: str | torch.device | None = None) -> torch.device:
    """Return the device that a name of ACCELERATORS (None: auto) or of torch, such as cuda:1, stands for here.

    Raises ValueError for one that isn't there.
    """
    name = name or "auto"
    choices = ACCELERATORS.get(str(name))
    if choices is None:
        return _torch_device(name)
    there = {"cuda": torch.cuda.is_available(), "mps": torch.backends.mps.is_available(), "cpu": True}
    for choice in choices:
        if there[choice]:
            return torch.device(choice)
    raise _unusable(name, "there is none")


def synchronize(device: torch.device) -> None:
    """Wait for what the device was asked to do: only then does a clock mean anything."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)
    elif device.type == "mps":
        torch.mps.synchronize()


def global_rank() -> int:
    """Return this process' rank as torchrun, Slurm or Lightning's launcher set it; 0 where nothing did."""
    # SLURM_PROCID may be set (to 0) where Slurm does not start the ranks, as in an interactive shell.
    for name in ("RANK", "LOCAL_RANK", "SLURM_PROCID"):
        if os.environ.get(name, "").isdigit():
            return int(os.environ[name])
    return 0


def local_rank() -> int:
    """Return this process' place among those of its machine; 0 where nothing launched several."""
    for name in ("LOCAL_RANK", "SLURM_LOCALID"):
        if os.environ.get(name, "").isdigit():
            return int(os.environ[name])
    return 0


def _torch_device(name: str | torch.device) -> torch.device:
    try:
        return torch.empty(0, device=name).device
    except (RuntimeError, AssertionError) as error:  # torch built without CUDA asserts
        raise _unusable(name, str(error).splitlines()[0]) from None


def _unusable(name: str | torch.device, reason: str) -> ValueError:
    return ValueError(f"device {str(name)!r} cannot be used here ({reason}); choose {find_device()}")

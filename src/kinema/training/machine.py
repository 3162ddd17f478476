"""Say where and how training runs."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any

import torch
from annotated_types import Interval, Len

from kinema.devices import ACCELERATORS, find_device, local_rank
from kinema.options import Count, Matches, Number, OneOf, Options, Size, Threads

Devices = (
    Annotated[int, Interval(ge=-1, le=4096)]
    | Annotated[str, Matches(r"auto|-1|\d+(,\d+)*", "auto or numbers with commas")]
    | Annotated[list[Number], Len(1)]
)
PRECISIONS = ("32-true", "16-mixed", "bf16-mixed")
"""Weights, averages and statistics are float32 in all of them: an average of .9999 doesn't move in fewer bits."""
PROGRESS = ("rich", "tqdm", "none")
EXTRAS = ("benchmark", "deterministic", "detect_anomaly", "inference_mode", "profiler")
"""What else Lightning's Trainer may be told: its other arguments change what is computed, and no identity has them."""


@dataclass(frozen=True)
class Machine(Options):
    """Say where and how to run: nothing of it changes what is computed (beyond rounding).

    It may be of another machine than this one, such as the nodes of a cluster.
    """

    accelerator: Annotated[str, OneOf(ACCELERATORS)] = "auto"
    devices: Devices = 1
    num_nodes: Size = 1
    strategy: str = "auto"
    precision: Annotated[str, OneOf(PRECISIONS)] = "32-true"
    compile: bool = False
    threads: Threads | None = None
    progress: Annotated[str, OneOf(PROGRESS)] = "rich"
    log_every: Count = 50
    extra: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in self.extra.keys() - set(EXTRAS):
            raise ValueError(f"trainer.extra.{name}: only {', '.join(EXTRAS)} leave what a run computes as it is")

    def device(self) -> torch.device:
        """Return the device of this process: of several, that which Lightning gives it.

        Raises ValueError where it isn't there.
        """
        device = find_device(self.accelerator)
        if device.type != "cuda":
            return device
        named = self.devices.split(",") if isinstance(self.devices, str) and "," in self.devices else self.devices
        if isinstance(named, list):
            numbers = [int(number) for number in named]
        else:
            there = torch.cuda.device_count()
            numbers = list(range(there if named in ("auto", "-1", -1) else min(int(named), there)))
        return torch.device("cuda", numbers[local_rank() % len(numbers)])

    def check(self) -> None:
        """Raise ValueError where the device isn't there, or computes otherwise than asked for."""
        device = self.device()
        if self.precision == "16-mixed" and device.type == "cpu":
            raise ValueError(
                "trainer.precision=16-mixed on a CPU computes in bf16, under the identity of a run in fp16; choose "
                "trainer.precision=bf16-mixed or 32-true"
            )

    def limit_threads(self) -> None:
        """Use this many CPU threads from now on (None: as many as torch takes)."""
        if self.threads is not None:
            torch.set_num_threads(self.threads)

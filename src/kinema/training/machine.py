"""Say where and how training runs."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any

import torch
from annotated_types import Interval, Len

from kinema.devices import ACCELERATORS, find_device
from kinema.options import Count, Matches, Number, OneOf, Options, Size, Threads

Devices = (
    Annotated[int, Interval(ge=-1, le=4096)]
    | Annotated[str, Matches(r"auto|-1|\d+(,\d+)*", "auto or numbers with commas")]
    | Annotated[list[Number], Len(1)]
)
PRECISIONS = ("32-true", "16-mixed", "bf16-mixed", "64-true", "16-true", "bf16-true")
PROGRESS = ("rich", "tqdm", "none")


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

    def device(self) -> torch.device:
        """Find what is trained on; raises ValueError where it isn't there, or computes otherwise than asked for."""
        device = find_device(self.accelerator)
        if self.precision == "16-mixed" and device.type == "cpu":
            raise ValueError(
                "trainer.precision=16-mixed on a CPU computes in bf16, under the identity of a run in fp16; choose "
                "trainer.precision=bf16-mixed or 32-true"
            )
        return device

    def limit_threads(self) -> None:
        """Use this many CPU threads from now on (None: as many as torch takes)."""
        if self.threads is not None:
            torch.set_num_threads(self.threads)

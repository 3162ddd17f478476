"""Count what passes through networks while motion is sampled: calls, and the rows of all calls."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from torch import nn


class NetworkCounter:
    """Count the calls of some modules and the rows of their first input; both halves of guidance are rows."""

    def __init__(self, networks: Mapping[str, nn.Module]) -> None:
        self.calls, self.rows = dict.fromkeys(networks, 0), dict.fromkeys(networks, 0)
        for name, module in networks.items():
            module.register_forward_pre_hook(self._counts(name))

    def take(self, batches: int, motions: int) -> dict[str, float]:
        """Return NAME_calls of each batch and NAME_rows of each motion since the last call, and begin anew."""
        measured = {f"{name}_calls": count / max(1, batches) for name, count in self.calls.items()}
        measured |= {f"{name}_rows": count / max(1, motions) for name, count in self.rows.items()}
        self.calls, self.rows = dict.fromkeys(self.calls, 0), dict.fromkeys(self.rows, 0)
        return measured

    def _counts(self, name: str) -> Any:
        def count(module: nn.Module, inputs: tuple[Any, ...]) -> None:
            self.calls[name] += 1
            self.rows[name] += len(inputs[0])

        return count

"""Hold what a spec describes to the tensors that it comes with, before memory is asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.overrides import TorchFunctionMode

from kinema import __version__
from kinema.runs.build import build

LARGEST = 100_000
"""A number that any spec may hold; a greater one must be below the count of numbers in its weights."""
MOST_BUFFERS = 1 << 26
"""Numbers in buffers that are computed, not saved (positions, schedules): a quarter of a GB."""


def check_spec(spec: Any, state: Mapping[str, Tensor], path: Path) -> None:
    """Raise ValueError, naming the file, unless the spec builds a module with the tensors that are there.

    It is built on the meta device, where a tensor costs nothing, and given up when it does far more than they need.
    """
    try:
        _refuse_large(spec, max(LARGEST, sum(tensor.numel() for tensor in state.values())))
        with torch.device("meta"), _Patience(10_000 + 200 * len(state)):
            module = build(spec)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    except Exception as error:  # whatever a constructor makes of arguments that nobody checked
        raise ValueError(
            f"the spec in {path} can't be built ({type(error).__name__}: {error}); write it again"
        ) from None
    if not isinstance(module, nn.Module):
        raise ValueError(f"the spec in {path} describes {type(module).__name__}, not a module; write it again")
    wanted = _saved(module)
    for key in sorted(wanted.keys() | {key for key in state if not key.endswith("_extra_state")}):
        here, there = wanted.get(key), state.get(key)
        if here is None or there is None or here.shape != there.shape:
            raise ValueError(
                f"the weights in {path} do not fit version {__version__}: {key!r} is {_shape(there)} in the file, "
                f"{_shape(here)} by its spec; import or train it again"
            )
    computed = sum(buffer.numel() for name, buffer in module.named_buffers() if name not in wanted)
    if computed > MOST_BUFFERS:
        raise ValueError(f"the spec in {path} asks for buffers of {computed:,} numbers, more than {MOST_BUFFERS:,}")


def _saved(module: nn.Module) -> dict[str, Tensor]:
    """Return the tensors that a module saves; what it writes about itself is left out, since it may have to be read."""
    found: dict[str, Tensor] = {}
    for place, part in module.named_modules(remove_duplicate=False):
        own = part._parameters | {k: v for k, v in part._buffers.items() if k not in part._non_persistent_buffers_set}
        found |= {f"{place}.{name}".lstrip("."): tensor for name, tensor in own.items() if tensor is not None}
    return found


def _shape(tensor: Tensor | None) -> str:
    return "missing" if tensor is None else str(tuple(tensor.shape))


def _refuse_large(spec: Any, most: int) -> None:
    for name, value in _values(spec):
        if isinstance(value, int | float) and abs(value) > most:
            raise ValueError(f"{name}={value!r} is more than the weights have numbers, {most:,}; write them again")


def _values(spec: Any, name: str = "spec") -> Iterator[tuple[str, Any]]:
    """Yield every plain value of a spec under the name of its argument."""
    if isinstance(spec, Mapping):
        for key, value in spec.items():
            yield from _values(value, str(key))
    elif isinstance(spec, list | tuple):
        for value in spec:
            yield from _values(value, name)
    else:
        yield name, spec


class _Patience(TorchFunctionMode):
    """Give up when more operations are done than so many, as by a module of a billion layers."""

    def __init__(self, most: int) -> None:
        super().__init__()
        self.left = most

    def __torch_function__(
        self, func: Callable[..., Any], types: Any, args: tuple[Any, ...] = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        """Count the operation, and do it."""
        self.left -= 1
        if self.left < 0:
            raise ValueError("the spec describes far more than its weights hold; write them again")
        return func(*args, **(kwargs or {}))

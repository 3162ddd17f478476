"""Read checkpoint files without running what is in them, and carry their tensors into our modules by name."""

from __future__ import annotations

import pickle
import re
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy._core.multiarray import scalar
from safetensors.torch import load_file
from torch import Tensor, nn

from kinema.runs.build import build

Rules = Sequence[tuple[str, str | None]]
"""Pattern of a whole published key -> our key (`\\1` inserts groups), or None for a key that is not needed."""

# Published files carry best scores as NumPy scalars beside the weights; rebuilding one runs nothing.
_NUMPY_SCALARS: list[Callable[..., Any] | tuple[Callable[..., Any], str]] = [
    np.dtype,
    *(type(np.dtype(kind)) for kind in ("float64", "float32", "int64", "int32", "bool")),
    (scalar, "numpy.core.multiarray.scalar"),
    (scalar, "numpy._core.multiarray.scalar"),
]


def read_checkpoint(path: str | Path) -> dict[str, Any]:
    """Read a .tar/.pth/.pt/.ckpt (torch) or .safetensors file as data only, on the CPU, memory-mapped where possible.

    Raises FileNotFoundError, or ValueError for a file that is damaged, holds code, or holds no dict.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(
            f"no checkpoint file at {path}; give the path of a .tar, .pth, .pt or .safetensors file"
        )
    try:
        if path.suffix == ".safetensors":
            content = load_file(path)
        else:
            with torch.serialization.safe_globals(_NUMPY_SCALARS):
                content = torch.load(path, map_location="cpu", weights_only=True, mmap=zipfile.is_zipfile(path))
    except pickle.UnpicklingError as error:
        raise ValueError(_refusal(path, error)) from None
    except Exception as error:  # a cut-off pickle can fail in any way: struct.error, KeyError, TypeError ...
        raise ValueError(_damaged(path, error)) from None
    if not isinstance(content, dict):
        raise ValueError(f"{path} holds a {type(content).__name__}, not a dict of tensors; give a checkpoint file")
    return content


def unwrap(content: Mapping[str, Any], wrappers: Sequence[str], *, several: bool = False) -> dict[str, Tensor]:
    """Take the state dict out of a published file's wrapper.

    `wrappers` names the entries that may hold it, the preferred first; with `several` they hold a part each and the
    result keeps their names as key prefixes. A bare state dict passes, with or without those prefixes. `module.` (data
    parallel) and the frozen text encoder (`clip_model.*`) are removed. A Lightning file has one more wrapper.
    """
    if isinstance(content.get("state_dict"), Mapping):
        content = content["state_dict"]
    parts = {name: content[name] for name in wrappers if isinstance(content.get(name), Mapping)}
    if not parts:
        for name in wrappers:
            inner = {k[len(name) + 1 :]: v for k, v in content.items() if k.startswith(f"{name}.")}
            if inner:
                parts[name] = inner
    if parts and several:
        state = {f"{name}.{_plain(k)}": v for name, part in parts.items() for k, v in part.items()}
    else:
        state = {_plain(k): v for k, v in (next(iter(parts.values())) if parts else content).items()}
    state = {k: v for k, v in state.items() if "clip_model." not in k}
    if not state or not all(isinstance(v, Tensor) for v in state.values()):
        found = ", ".join(map(str, list(content)[:8])) or "nothing"
        raise ValueError(f"found no state dict: expected the entry {' or '.join(wrappers)}, the file holds {found}")
    return state


def transfer(
    spec: dict[str, Any],
    state: Mapping[str, Tensor],
    rules: Rules,
    *,
    kind: str,
    ours: Sequence[str] = ("representation.",),
) -> nn.Module:
    """Build `spec` and load published tensors into it under the names that the first matching rule gives them.

    The module keeps the spec as `.spec`, so that it can be saved as an artifact. `ours` are prefixes of our own
    entries that published files don't have. Raises ValueError that lists the unknown keys, the missing ones and those
    of another shape (the first few of each).
    """
    module = build(spec)
    renamed, unknown = {}, []
    for key, value in state.items():
        rule = next(((p, to) for p, to in rules if re.fullmatch(p, key)), None)
        if rule is None:
            unknown.append(key)
        elif rule[1] is not None:
            renamed[re.sub(f"^{rule[0]}$", rule[1], key)] = value
    expected = {k: v for k, v in module.state_dict().items() if not k.startswith(tuple(ours))}
    problems = {
        "unknown": unknown + [k for k in renamed if k not in expected],
        "missing": [k for k in expected if k not in renamed],
        "of another shape": [
            f"{k} {tuple(renamed[k].shape)} instead of {tuple(v.shape)}"
            for k, v in expected.items()
            if k in renamed and renamed[k].shape != v.shape
        ],
    }
    if any(problems.values()):
        listed = "; ".join(f"{len(keys)} {what}: {_few(keys)}" for what, keys in problems.items() if keys)
        raise ValueError(f"this state dict is not that of a {kind!r}: {listed}")
    module.load_state_dict(renamed, strict=False)
    module.spec = spec
    return module


def require(state: Mapping[str, Tensor], key: str, *, kind: str) -> Tensor:
    """Return the tensor that sizes are derived from, or say that this is no such checkpoint."""
    if key not in state:
        raise ValueError(f"this state dict is not that of a {kind!r}: {key!r} is missing; it holds {_few(list(state))}")
    return state[key]


def count(state: Mapping[str, Tensor], pattern: str) -> int:
    """Count the distinct indices that the one group of `pattern` takes at the start of the keys."""
    return len({m.group(1) for m in (re.match(pattern, k) for k in state) if m})


def _plain(key: str) -> str:
    return key.removeprefix("module.")


def _few(keys: Sequence[str], size: int = 5) -> str:
    return ", ".join(keys[:size]) + (", ..." if len(keys) > size else "")


def _damaged(path: Path, error: BaseException) -> str:
    reason = (str(error).strip().splitlines() or [type(error).__name__])[0][:160]
    return f"{path} cannot be read as a checkpoint ({reason}): truncated, or of another kind; download it again"


def _refusal(path: Path, error: pickle.UnpicklingError) -> str:
    named = re.search(r"(?:GLOBAL|global|class|function) ([\w.]+)", str(error))
    if named is None and "Unsupported" not in str(error):
        return _damaged(path, error)
    name = named.group(1) if named else "an unsupported object"
    return f"{path} holds more than tensors ({name}) and could run code, so it is not loaded; save its state dict alone"

"""Read checkpoint files without running what is in them, and carry their tensors into our modules by name."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from torch import Tensor, nn

from kinema.files.checkpoints import read_safetensors, read_torch
from kinema.runs.build import build

Rules = Sequence[tuple[str, str | None]]
"""Pattern of a whole published key -> our key (`\\1` inserts groups), or None for a key that is not needed."""


def read_checkpoint(path: str | Path) -> dict[str, Any]:
    """Read a .tar/.pth/.pt/.ckpt (torch) or .safetensors file as data only, on the CPU, memory-mapped where possible.

    Raises FileNotFoundError, or ValueError for a file that is damaged, holds code, or holds no dict.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(
            f"no checkpoint file at {path}; give the path of a .tar, .pth, .pt or .safetensors file"
        )
    fix = "download it again, or save its state dict alone"
    return read_safetensors(path, fix=fix)[0] if path.suffix == ".safetensors" else read_torch(path, fix=fix)


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

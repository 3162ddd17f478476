"""Read the files of torch and of safetensors as data: nothing in them is run, nothing is allocated on their word."""

from __future__ import annotations

import pickle
import re
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy._core.multiarray import scalar
from safetensors import SafetensorError, safe_open
from torch import Tensor

from kinema.files.kinds import describe, head_of, refuse, require_file, size

FIX = "download or copy it again"

# Published files carry best scores as NumPy scalars beside the weights; rebuilding one runs nothing.
_NUMPY_SCALARS: list[Callable[..., Any] | tuple[Callable[..., Any], str]] = [
    np.dtype,
    *(type(np.dtype(kind)) for kind in ("float64", "float32", "int64", "int32", "bool")),
    (scalar, "numpy.core.multiarray.scalar"),
    (scalar, "numpy._core.multiarray.scalar"),
]
_PICKLES = (b"\x80", b"PK\x03\x04")


def read_torch(path: str | Path, *, device: Any = "cpu", mapped: bool = True, fix: str = FIX) -> dict[str, Any]:
    """Read a dict of tensors and plain values that torch saved, `mapped` into memory where that is possible.

    Raises FileNotFoundError, or ValueError for a file that is damaged, of another kind, or holds code.
    """
    path = require_file(path, fix)
    head = head_of(path)
    if not head.startswith(_PICKLES):
        raise refuse(path, f"{describe(head)}, no checkpoint of torch", fix)
    archive = _check_archive(path, fix) if head.startswith(b"PK") else False
    try:
        with torch.serialization.safe_globals(_NUMPY_SCALARS):
            content = torch.load(path, map_location=device, weights_only=True, mmap=archive and mapped)
    except pickle.UnpicklingError as error:
        raise _refusal(path, error, fix) from None
    except Exception as error:  # a cut-off pickle can fail in any way: struct.error, KeyError, TypeError ...
        raise _damaged(path, error, fix) from None
    if not isinstance(content, dict):
        raise refuse(path, f"holds a {type(content).__name__}, not a dict of tensors", "give a checkpoint file")
    return content


def read_safetensors(path: str | Path, *names: str, fix: str = FIX) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Read the tensors of a safetensors file, all or those named, and the texts in its header.

    Raises FileNotFoundError, or ValueError for a file that is damaged, of another kind, or lacks a name.
    """
    path = require_file(path, fix)
    try:
        with safe_open(path, "pt") as file:
            there = file.keys()
            if missing := [name for name in names if name not in there]:
                raise refuse(path, f"holds no {', '.join(missing[:5])}", fix)
            return {name: file.get_tensor(name) for name in names or there}, file.metadata() or {}
    except (SafetensorError, OSError) as error:
        raise _no_safetensors(path, error, fix) from None


def read_header(path: str | Path, *, fix: str = FIX) -> dict[str, str]:
    """Read the texts in a safetensors file's header alone; errors as of `read_safetensors`."""
    path = require_file(path, fix)
    try:
        with safe_open(path, "pt") as file:
            return file.metadata() or {}
    except (SafetensorError, OSError) as error:
        raise _no_safetensors(path, error, fix) from None


def _check_archive(path: Path, fix: str) -> bool:
    """Refuse an archive that would unpack to more than it has: torch compresses nothing."""
    try:
        with zipfile.ZipFile(path) as archive:
            unpacked = sum(info.file_size for info in archive.infolist())
    except Exception as error:  # zipfile fails in as many ways as an archive can be damaged
        raise _damaged(path, error, fix) from None
    if unpacked > (packed := path.stat().st_size):
        raise refuse(path, f"has {size(packed)} and would unpack to {size(unpacked)}, no checkpoint of torch", fix)
    return True


def _no_safetensors(path: Path, error: Exception, fix: str) -> Exception:
    what = describe(head_of(path))
    if what in ("is text", "is of an unknown kind"):  # and nothing better can be said
        what = f"cannot be read ({error}): truncated or no safetensors file"
    return refuse(path, what, fix)


def _damaged(path: Path, error: BaseException, fix: str) -> Exception:
    reason = (str(error).strip().splitlines() or [type(error).__name__])[0][:160]
    if "unsafe" in reason or "weights_only" in reason:  # torch's advice, which is none to follow
        reason = type(error).__name__
    return refuse(path, f"cannot be read as a checkpoint ({reason}): truncated, or of another kind", fix)


def _refusal(path: Path, error: pickle.UnpicklingError, fix: str) -> Exception:
    named = re.search(r"(?:GLOBAL|global|class|function) ([\w.]+)", str(error))
    if named is None and "Unsupported" not in str(error):
        return _damaged(path, error, fix)
    name = named.group(1) if named else "an unsupported object"
    what = f"holds more than tensors ({name}) and could run code, so it is not loaded"
    return refuse(path, what, fix)

"""Read and write run folders: weights.safetensors, upstream.json, text.json, status.json."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from kinema.runs import weights as artifacts
from kinema.atomic import write_text


GENERATOR, TOKENIZER, LENGTH = "generator", "tokenizer", "length"
"""The parts that a pipeline itself knows by name; a generator names those that it takes."""


def load_part(folder: Path, device: torch.device | str, part: str | None = None) -> tuple[Any, dict[str, Any]]:
    """Load the module of one run folder; says so if the run is not finished, or holds another part than `part`."""
    if not folder.is_dir():
        raise FileNotFoundError(f"no run folder at {folder}; check the path, or train or import that part first")
    if not (folder / artifacts.WEIGHTS).is_file():
        state = read_json(folder / "status.json").get("state", "unknown")
        raise FileNotFoundError(f"{folder} has no {artifacts.WEIGHTS} (its state is {state!r}); finish training it")
    found = artifacts.read_meta(folder / artifacts.WEIGHTS).get("part")
    if part is not None and found != part:
        raise ValueError(f"{folder} holds a run of {found!r}; give the folder of a {part!r} run")
    return artifacts.load(folder / artifacts.WEIGHTS, device)


def read_json(path: Path) -> dict[str, Any]:
    """Read a small JSON object; a missing file is an empty one."""
    if not path.is_file():
        return {}
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{path} is damaged ({error}); train or import this run again") from None


def write_json(path: Path, value: dict[str, Any]) -> None:
    """Write a small JSON object, whole or not at all."""
    write_text(path, json.dumps(value, indent=1, sort_keys=True) + "\n")


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Yield a temporary folder beside `path` that becomes it on success and vanishes on failure.

    Raises ValueError if `path` exists.
    """
    if path.exists():
        raise ValueError(f"{path} exists; choose another folder or remove it")
    path.parent.mkdir(parents=True, exist_ok=True)
    staging = Path(tempfile.mkdtemp(prefix=f".{path.name}-", dir=path.parent))
    try:
        yield staging
        staging.chmod(0o755)
        os.replace(staging, path)
    finally:
        shutil.rmtree(staging, ignore_errors=True)

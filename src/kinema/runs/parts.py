"""Link a run to the runs of its parts and to its text encoder, and load what a run holds."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from kinema.atomic import write_json
from kinema.files.json import Each
from kinema.runs import weights
from kinema.runs.folder import RunFolder, read_about

GENERATOR, TOKENIZER, LENGTH = "generator", "tokenizer", "length"
"""The parts that a pipeline itself knows by name; a generator names those that it takes."""

MATCHING, CONTRASTIVE = "matching", "contrastive"
"""The evaluators, T2M-style and CLIP-style."""

UPSTREAM, TEXT = "upstream.json", "text.json"
ENCODER = {"encoder": str, "path": str | None}


def load_part(folder: Path, device: torch.device | str = "cpu", part: str | None = None) -> tuple[Any, dict[str, Any]]:
    """Load the module of one run folder, with the metadata of its weights.

    Raises FileNotFoundError if the run is missing or not finished, ValueError if it holds another part than `part`.
    """
    run = RunFolder(folder)
    if not folder.is_dir():
        raise FileNotFoundError(f"no run folder at {folder}; check the path, or train or import that part first")
    if not run.weights.is_file():
        state = run.status["state"]
        raise FileNotFoundError(f"{folder} has no {run.weights.name} (its state is {state!r}); finish training it")
    found = weights.read_meta(run.weights).get("part")
    if part is not None and found != part:
        raise ValueError(f"{folder} holds a run of {found!r}; give the folder of a {part!r} run")
    return weights.load(run.weights, device)


def link(run: Path, parts: Mapping[str, Path]) -> None:
    """Write which runs hold a run's parts: relative paths, so that a tree of runs can be moved as a whole."""
    write_json(run / UPSTREAM, {name: os.path.relpath(part, run) for name, part in parts.items()})


def upstream(run: Path) -> dict[str, Path]:
    """Read which runs hold a run's parts; none where nothing was linked."""
    return {name: (run / part).resolve() for name, part in read_about(run / UPSTREAM, Each(str)).items()}


def write_text_encoder(run: Path, name: str, path: str | None) -> None:
    """Write which text encoder a run's model reads."""
    write_json(run / TEXT, {"encoder": name, "path": path})


def read_text_encoder(run: Path) -> dict[str, Any]:
    """Read which text encoder a run's model reads: `encoder` and `path`; nothing where it reads none."""
    return read_about(run / TEXT, ENCODER)

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
from kinema.runs.consent import ask, require_asked
from kinema.runs.folder import RunFolder, read_about

GENERATOR, TOKENIZER, LENGTH = "generator", "tokenizer", "length"
"""The parts that a pipeline itself knows by name; a generator names those that it takes."""

MATCHING, CONTRASTIVE = "matching", "contrastive"
"""The evaluators, T2M-style and CLIP-style."""

DECOMPOSITION = "decomposition"
"""The autoencoder of short windows whose encoder the T2M-style evaluator reads."""

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
    if part is not None:
        check_part(folder, part)
    return weights.load(run.weights, device)


def check_part(folder: Path, part: str) -> None:
    """Raise ValueError if a run with weights holds another part than that."""
    found = weights.read_meta(RunFolder(folder).weights).get("part")
    if found != part:
        raise ValueError(f"{folder} holds a run of {found!r}; give the folder of a {part!r} run")


def link(run: Path, parts: Mapping[str, Path], *, place: Path | None = None) -> None:
    """Write which runs hold a run's parts: relative paths, so that a tree of runs can be moved as a whole.

    `place` is where the run will stand beside `run`, if it is being written.
    """
    for name, part in parts.items():
        if not _near(run, name, part.resolve()):
            ask(place or run, name, str(part.resolve()))
    write_json(run / UPSTREAM, {name: os.path.relpath(part.resolve(), run.resolve()) for name, part in parts.items()})


def upstream(run: Path) -> dict[str, Path]:
    """Read which runs hold a run's parts; none where nothing was linked.

    Raises ValueError for a part outside of the run's tree, unless this user asked for it.
    """
    return {name: _part(run, name, part) for name, part in read_about(run / UPSTREAM, Each(str)).items()}


def write_text_encoder(run: Path, name: str, path: str | None, *, place: Path | None = None) -> None:
    """Write which text encoder a run's model reads; `place` as of `link`."""
    if path is not None:
        ask(place or run, "text", str(path))
    write_json(run / TEXT, {"encoder": name, "path": path})


def read_text_encoder(run: Path) -> dict[str, Any]:
    """Read which text encoder a run's model reads: `encoder` and `path`; nothing where it reads none."""
    return read_about(run / TEXT, ENCODER)


def _part(run: Path, name: str, part: str) -> Path:
    path = Path(os.path.realpath(run / part))  # a link in the folder may lead anywhere
    if not _near(run, name, path):
        require_asked(run, name, str(path), f"{run / UPSTREAM} takes its {name} from")
    return path


def _near(run: Path, name: str, path: Path) -> bool:
    """Say whether a part lies in a run's folder or in its tree of runs: one folder a stage, called as the part is."""
    home = run.resolve()
    stage = path.parent
    return path.is_relative_to(home) or (stage.name == name and stage.parent == home.parent.parent)

"""Link a run to the runs of its parts and to its text encoder, and load what a run holds."""

from __future__ import annotations

import contextlib
import os
import shlex
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

DECOMPOSITION = "decomposition"
"""The autoencoder of short windows whose encoder the T2M-style evaluator reads."""

UPSTREAM, TEXT = "upstream.json", "text.json"
ENCODER = {"encoder": str, "path": str | None}

ASKED = "asked"
"""The folder of links to what a run reads outside of itself and its tree of runs."""


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


def link(run: Path, parts: Mapping[str, Path]) -> None:
    """Write which runs hold a run's parts: relative paths, so that a tree of runs can be moved as a whole."""
    for name, part in parts.items():
        if not _near(run, Path(os.path.abspath(part))):
            _ask(run, name, os.path.abspath(part))
    write_json(run / UPSTREAM, {name: os.path.relpath(part, run) for name, part in parts.items()})


def upstream(run: Path) -> dict[str, Path]:
    """Read which runs hold a run's parts; none where nothing was linked.

    Raises ValueError for a part outside of the run's tree, unless it was asked for on this machine.
    """
    return {name: _part(run, name, part) for name, part in read_about(run / UPSTREAM, Each(str)).items()}


def write_text_encoder(run: Path, name: str, path: str | None) -> None:
    """Write which text encoder a run's model reads."""
    if path is not None:
        _ask(run, "text", str(path))
    write_json(run / TEXT, {"encoder": name, "path": path})


def read_text_encoder(run: Path) -> dict[str, Any]:
    """Read which text encoder a run's model reads: `encoder` and `path`; nothing where it reads none."""
    return read_about(run / TEXT, ENCODER)


def require_asked(run: Path, name: str, where: str, what: str) -> None:
    """Raise ValueError unless somebody on this machine asked for a part of a run that lies outside of it.

    Who trains or imports asks, and a symbolic link says so: what is only written in a file of the folder, which may
    have come from anywhere, is not followed.
    """
    asked = run / ASKED / name
    if not asked.is_symlink() or os.readlink(asked) != where:
        command = f"mkdir -p {shlex.quote(str(run / ASKED))} && ln -sfn {shlex.quote(where)} {shlex.quote(str(asked))}"
        raise ValueError(f"{what} {where!r}, which lies outside; if you trust that: {command}")


def _part(run: Path, name: str, part: str) -> Path:
    path = Path(os.path.normpath(run.resolve() / part))
    if not _near(run, path):
        require_asked(run, name, str(path), f"{run / UPSTREAM} takes its {name} from")
    return path.resolve()


def _near(run: Path, path: Path) -> bool:
    """Say whether a path lies in a run's folder or in its tree of runs, which is that of two folders above."""
    return path.is_relative_to(run.resolve().parent.parent)


def _ask(run: Path, name: str, where: str) -> None:
    asked = run / ASKED / name
    with contextlib.suppress(OSError):  # a disk without links: then whoever loads the run is told
        asked.parent.mkdir(parents=True, exist_ok=True)
        asked.unlink(missing_ok=True)
        asked.symlink_to(where)

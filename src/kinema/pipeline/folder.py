"""Read a generator's run folder with all that it is used with, and write everything as one portable folder."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import nn

from kinema.atomic import new_folder
from kinema.generators import Generator
from kinema.pipeline.card import Card
from kinema.pipeline.compatibility import check_representation
from kinema.pipeline.repertoire import Repertoire
from kinema.runs import weights
from kinema.runs.consent import require_asked
from kinema.runs.folder import RunFolder
from kinema.runs.parts import (
    GENERATOR,
    LENGTH,
    TEXT,
    TOKENIZER,
    UPSTREAM,
    check_part,
    link,
    load_part,
    read_text_encoder,
    upstream,
    write_text_encoder,
)
from kinema.text.encoders import ENCODERS, build_text_encoder
from kinema.text.frozen import FrozenTextEncoder
from kinema.tokenizers import MotionTokenizer

Parts = tuple[MotionTokenizer, Generator, FrozenTextEncoder, dict[str, nn.Module], dict[str, Any]]
"""Tokenizer, generator, text encoder, what stands beside the generator, and the weights' metadata."""


def read_parts(folder: Path, device: torch.device, given: Mapping[str, str | Path | None]) -> Parts:
    """Load a generator's run with the parts that it links to; `given` replaces links, None leaves a part out.

    The run of a part that was trained on a generator (a shortcut) stands for that generator with this part beside it.
    Raises FileNotFoundError or ValueError that name the part that is missing or unfit.
    """
    trained = upstream(folder).get(GENERATOR)
    if trained is not None and (own := weights.read_meta(RunFolder(folder).weights)["part"]) != GENERATOR:
        check_part(trained, GENERATOR)
        return read_parts(trained, device, {own: folder, **given})
    generator, meta = load_part(folder, device, GENERATOR)
    links = upstream(folder)
    if TOKENIZER not in links:
        raise ValueError(f"{folder / UPSTREAM} names no {TOKENIZER}; train or import this run again")
    encoder, text = open_text_encoder(folder, device)
    allowed = (*generator.parts, LENGTH)
    for name in sorted(name for name, run in given.items() if run is not None and name not in allowed):
        takes = ", ".join(f"{part}=" for part in allowed)
        raise ValueError(f"{type(generator).__name__} takes no part {name!r}; it takes {takes}")
    tokenizer, _ = load_part(links.pop(TOKENIZER), device, TOKENIZER)
    runs: dict[str, str | Path | None] = {**links, **given}
    check_representation(meta.get("representation"), tokenizer)
    if meta.get("text", encoder.identity) != encoder.identity:
        variable = ENCODERS[text["encoder"]].variable
        told = f"; set {variable}=FOLDER to where that one lies" if variable else ""
        raise ValueError(
            f"{folder} was trained with the text encoder {meta['text']}, this one is {encoder.identity}{told}"
        )
    parts = {name: load_part(Path(run), device, name)[0] for name, run in runs.items() if run is not None}
    return tokenizer, generator, encoder, parts, {**meta, "text": text}


def open_text_encoder(folder: Path, device: torch.device | str = "cpu") -> tuple[FrozenTextEncoder, dict[str, Any]]:
    """Find the text encoder that a run's model reads, and how it is named; raises ValueError where none is."""
    text = read_text_encoder(folder)
    if "encoder" not in text:
        raise ValueError(f"{folder / TEXT} names no encoder; train or import this run again")
    return build_text_encoder(text["encoder"], _text_path(folder, text), device), text


def _text_path(folder: Path, text: dict[str, Any]) -> str | None:
    """Return where a run's text encoder lies: its published place, the run's own folder, or what was asked for."""
    path, kind = text.get("path"), ENCODERS.get(text["encoder"])
    if path is None:
        return None
    if kind is not None and path == kind.published:
        return kind.here()
    inside = Path(os.path.realpath(folder / path))
    if inside.is_relative_to(folder.resolve()) and inside.is_dir():
        return str(inside)
    require_asked(folder, "text", path, f"{folder / TEXT} takes its text encoder from")
    return path


def write_parts(
    path: Path,
    generator: Generator,
    parts: Mapping[str, nn.Module],
    text: dict[str, Any],
    meta: dict[str, Any],
    about: Sequence[Card | Repertoire] = (),
    *,
    half: bool = False,
    replace: bool = False,
) -> None:
    """Write a generator with `meta`, its parts and what is known `about` it as one folder, whole or not at all.

    Raises ValueError if the folder exists; `replace`: if it holds no model.
    """
    with new_folder(path, replace=replace and RunFolder(path).weights.is_file()) as staging:
        _write(generator, staging, GENERATOR, half, **meta)
        for name, module in parts.items():
            _write(module, staging / name, name, half)
        for one in about:
            one.write(staging)
        link(staging, {name: staging / name for name in parts})
        # A folder of this machine is nothing to who gets the model; what was read there, the identity in `meta` says.
        kind = ENCODERS.get(text["encoder"])
        published = kind.published if kind is not None else None
        write_text_encoder(staging, text["encoder"], published or text.get("path"), place=path)
        RunFolder(staging).mark("done")


def _write(module: Any, folder: Path, part: str, half: bool, **meta: Any) -> None:
    if module.spec is None:
        raise ValueError(
            f"this {type(module).__name__} has no spec to save with; set module.spec to what it was built from"
        )
    weights.save(module, module.spec, RunFolder(folder).weights, half=half, part=part, **meta)

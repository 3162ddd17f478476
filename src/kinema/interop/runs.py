"""Write a published checkpoint as a run folder, linked to the runs that it is used with (`kinema import`)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torch import nn

from kinema import interop
from kinema.atomic import new_folder
from kinema.generators import LatentModel
from kinema.generators.remodiffuse.model import RETRIEVAL
from kinema.generators.tokens.generator import RESIDUAL
from kinema.interop import Kind, find_kind
from kinema.pipeline.compatibility import check_pair, check_text
from kinema.runs import weights
from kinema.runs.folder import RunFolder
from kinema.runs.parts import GENERATOR, LENGTH, TOKENIZER, link, load_part, write_text_encoder
from kinema.text.clip import WHOLE
from kinema.text.encoders import ENCODERS, build_text_encoder

LINKS = (TOKENIZER, RESIDUAL, RETRIEVAL, LENGTH)
"""What a run can be linked to."""

READS_TEXT = (GENERATOR, RESIDUAL, LENGTH)


def import_run(
    kind: str,
    source: str | Path,
    out: str | Path,
    *,
    links: Mapping[str, str | Path] | None = None,
    text: str = "clip_b32",
    text_path: str | None = None,
    options: Mapping[str, Any] | None = None,
) -> nn.Module:
    """Turn a published checkpoint into the run folder `out`; nothing is written unless all parts fit together.

    `links` names the run folders of its tokenizer, length estimator, residual transformer and database to retrieve
    from. A generator needs a tokenizer. `text` is the encoder it was trained with, which no file names; `options` are
    the importer's. Raises ValueError or FileNotFoundError.
    """
    linked = {part: Path(run) for part, run in (links or {}).items()}
    known = find_kind(kind)
    _check_links(kind, known, linked)
    if text not in ENCODERS:
        raise ValueError(f"unknown text encoder {text!r}; choose --text one of {', '.join(ENCODERS)}")
    parts = {part: load_part(run, "cpu", part)[0] for part, run in linked.items()}
    module: Any = interop.load(kind, source, **(options or {}))
    fitted = {known.part: module, **parts}
    check_parts(fitted)
    if module.spec.get("words") == "all" and text not in WHOLE:
        raise ValueError(f"words=all reads all 77 positions, --text {text} gives the text's own; use {WHOLE[0]}")
    if known.part in READS_TEXT and (text_path is not None or not ENCODERS[text].fetched()):
        encoder = build_text_encoder(text, text_path or ENCODERS[text].here())
        check_text(encoder, {name: fitted[name] for name in READS_TEXT if name in fitted})
    with new_folder(out) as folder:
        about: dict[str, Any] = {"part": known.part, "kind": kind, "source": str(source)}
        weights.save(module, module.spec, RunFolder(folder).weights, **about)
        link(folder, linked, place=Path(out))
        if known.part in READS_TEXT:
            write_text_encoder(folder, text, text_path, place=Path(out))
        RunFolder(folder).mark("done", imported=str(source))
    return module


def check_parts(parts: Mapping[str, Any]) -> None:
    """Raise one ValueError that names what doesn't match: codes, downsampling, the codebook, the text's width."""
    tokenizer, generator = parts.get(TOKENIZER), parts.get(GENERATOR)
    for name, part in parts.items():
        if generator is not None and name in generator.parts:
            generator.attach(name, part)
        if tokenizer is not None and isinstance(part, LatentModel):
            check_pair(tokenizer, part)
    readers = {name: part for name, part in parts.items() if isinstance(part, LatentModel)}
    widths = {name: part.text_dim for name, part in readers.items() if part.text_dim is not None}
    if len(set(widths.values())) > 1:
        listed = ", ".join(f"{name} {width}" for name, width in widths.items())
        raise ValueError(f"the parts read text vectors of different widths ({listed}); use parts of one text encoder")


def _check_links(kind: str, known: Kind, links: Mapping[str, Path]) -> None:
    published = {TOKENIZER: known.tokenizer, RESIDUAL: known.residual, RETRIEVAL: known.retrieval}
    allowed = [part for part, name in published.items() if name]
    if known.part == GENERATOR:
        allowed.append(LENGTH)
    for part in links:
        if part not in allowed:
            takes = " and ".join(f"--{name}" for name in allowed) or "no other run"
            raise ValueError(f"{kind} takes no --{part}; it takes {takes}")
    if known.part == GENERATOR and TOKENIZER not in links:
        raise ValueError(
            f"{kind} needs --tokenizer RUN, the run folder of the tokenizer that it was trained on "
            f"(published with it: kinema import {known.tokenizer})"
        )

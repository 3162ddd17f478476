"""Do what `kinema pack` and `kinema models` are asked: make a model portable, and list those at hand."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from kinema.cli.runs import aligned
from kinema.experiments.packing import pack as write_pack
from kinema.pipeline.models import Found, cached, find_model, shipped
from kinema.pipeline.repertoire import Repertoire
from kinema.runs.console import printable


def pack(options: argparse.Namespace) -> None:
    """Write a run as one folder that works anywhere."""
    model = write_pack(options.run, options.out, half=options.half, licence=options.licence, replace=options.replace)
    made = Found(str(options.out), Path(options.out))
    known = model.repertoire
    print(printable(f"wrote {made.name} ({made.size / 1e6:.1f} MB; licence: {made.card.licence})"))
    if known is None:
        print("note: the corpus names no actions (labels), so the model can't say which prompts are far from it")
    else:
        print(f"it knows {len(known.clips)} actions in {len(known.styles)} styles")


def models(options: argparse.Namespace) -> None:
    """List the models at hand, or say what one is and knows."""
    if options.name is not None:
        folder = find_model(options.name)
        if not folder.exists():
            raise FileNotFoundError(f"{options.name} is no model at hand; `kinema models` lists those there are")
        print(printable(_described(Found(options.name, folder))))
        return
    rows = [("model", "method", "corpus", "size", "licence", "where")]
    for where, found in (("this package", shipped()), ("hub cache", cached())):
        for one in found:
            try:
                card = one.card
            except ValueError as error:  # another program's card.json, or a damaged one
                print(printable(f"note: {one.name} is left out: {error}"), file=sys.stderr)
                continue
            corpus = card.corpus.partition(" (")[0]
            rows.append((one.name, card.method, corpus, f"{one.size / 1e6:.1f} MB", card.licence, where))
    print(printable(aligned(rows)) if len(rows) > 1 else "none; `kinema pack RUN --out FOLDER` makes one")


def _described(model: Found) -> str:
    card, known = model.card, Repertoire.read(model.folder)
    lines = [
        f"model     {model.name} ({model.size / 1e6:.1f} MB, in {model.folder})",
        f"method    {card.method} ({card.citation})",
        f"motion    {card.motion}",
        f"corpus    {card.corpus}",
        f"licence   {card.licence}",
        *(f"          {one['source']}: {one['licence']} ({one['clips']} clips)" for one in card.sources),
        f"text      {card.text_encoder}",
    ]
    if known is not None:
        lines += [f"actions   {_counted(known.clips)}", f"styles    {_counted(known.styles)}"]
    # A field is one line: a downloaded card must not write lines of its own.
    return "\n".join(["  ".join(line.splitlines()) for line in lines] + [f"card      {model.folder / 'README.md'}"])


def _counted(counts: dict[str, int]) -> str:
    return "; ".join(f"{name} ({count})" for name, count in counts.items()) or "none"

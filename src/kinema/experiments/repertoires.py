"""Collect which actions and styles a corpus has, as directions in a text encoder's space."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import torch
import yaml
from torch import Tensor

from kinema.data.labels import has_labels, label_of, read_label
from kinema.data.store import PackedStore
from kinema.files.yaml import read_yaml
from kinema.pipeline.repertoire import Repertoire, threshold_between, unit
from kinema.text.frozen import FrozenTextEncoder

FOREIGN = Path(__file__).with_name("foreign.yaml")


def repertoire_of(store: PackedStore, encoder: FrozenTextEncoder) -> Repertoire | None:
    """Collect what the training clips show: a direction for each label and for each action.

    A label's is the mean of its captions', an action's that of its name. Mirrored clips are left out: their labels
    name the other side. None for a corpus without labels.
    """
    captions = captions_of(store, "train") if has_labels(store) else {}
    if not captions:
        return None
    shown = [
        read_label(label_of(store, clip)) for clip in store.split_clips("train") if not store.clips[clip]["mirrored"]
    ]
    labels = sorted(set(captions.values()))
    rows = directions_of(list(captions), encoder)
    means = [rows[[i for i, one in enumerate(captions.values()) if one == label]].mean(0) for label in labels]
    actions = sorted({read_label(label)[0] for label in labels})
    known = Repertoire(
        torch.cat([unit(torch.stack(means)), directions_of(actions, encoder)]),
        [read_label(label)[0] for label in labels] + actions,
        dict(Counter(action for action, _ in shown).most_common()),
        dict(Counter(style for _, style in shown if style is not None).most_common()),
        threshold=0.0,
    )
    own = directions_of(list(captions_of(store, "val") or captions), encoder)
    foreign = directions_of(foreign_sentences(), encoder)
    threshold = threshold_between(_highest(known, own), _highest(known, foreign))
    return Repertoire(known.directions, known.owners, known.clips, known.styles, round(threshold, 4))


def captions_of(store: PackedStore, split: str) -> dict[str, str]:
    """Return the label of each distinct caption of a split's clips as they were captured."""
    found: dict[str, str] = {}
    for entry in store.split_entries(split):
        if not store.entries[entry]["mirrored"]:
            for caption in store.entry_captions(entry):
                found.setdefault(caption.text, label_of(store, store.entries[entry]["clip"]))
    return found


def foreign_sentences() -> list[str]:
    """Return sentences that no corpus at hand has a motion for."""
    return [sentence for group in yaml.safe_load(read_yaml(FOREIGN)).values() for sentence in group]


def directions_of(texts: list[str], encoder: FrozenTextEncoder) -> Tensor:
    """Return the texts' pooled vectors at length 1."""
    return unit(encoder(texts).pooled.float().cpu())


def _highest(known: Repertoire, rows: Tensor) -> Tensor:
    return known.similarities(rows).max(-1).values

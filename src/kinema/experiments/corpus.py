"""Find or make the packed store that a configuration's `data` group describes."""

from __future__ import annotations

from pathlib import Path

from omegaconf import DictConfig

from kinema.data.datasets import ClipDataset
from kinema.data.prepare import prepare_store
from kinema.data.store import PackedStore
from kinema.experiments.config import plain


def open_corpus(cfg: DictConfig) -> Path:
    """Prepare the corpus where it isn't yet and give its store's folder; a prepared one costs milliseconds."""
    data = plain(cfg.data)
    return prepare_store(
        data["reader"],
        data["source"],
        Path(cfg.paths.stores),
        name=data["name"],
        skeleton=data["skeleton"],
        mirror=data["mirror"],
        **data["options"],
    )


def require_captions(store: PackedStore, *splits: str) -> None:
    """Check that the splits have captioned clips of a usable length, before hours are spent on what comes first."""
    for split in splits:
        ClipDataset(store, split)

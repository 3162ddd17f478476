"""Find or make the packed store that a configuration's `data` group describes."""

from __future__ import annotations

import json
from pathlib import Path

from omegaconf import DictConfig

from kinema.data.prepare import prepare_store
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


def manifest(store: Path) -> dict:
    """Read a store's manifest; its `hash` identifies the content."""
    return json.loads((store / "manifest.json").read_text())

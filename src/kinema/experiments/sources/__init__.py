"""Hold what `source=` may name, one file each, and find it: a module put into this package is one without an edit."""

from __future__ import annotations

from functools import cache

from omegaconf import DictConfig

from kinema.experiments.discovery import discover
from kinema.experiments.sources.base import ScoredSource


def source_of(cfg: DictConfig) -> ScoredSource:
    """Return what a row scores; raises ValueError naming what there is."""
    if cfg.source not in sources():
        raise ValueError(f"source={cfg.source}: must be one of {', '.join(sources())}")
    return sources()[cfg.source]


def sources() -> dict[str, ScoredSource]:
    """Return all by name."""
    return dict(_find(tuple(__path__)))


@cache
def _find(folders: tuple[str, ...]) -> list[tuple[str, ScoredSource]]:
    return list(discover(__name__, folders, ScoredSource, "source").items())

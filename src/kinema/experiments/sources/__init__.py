"""Hold what `source=` may name, one file each, and find it: a module put into this package is one without an edit."""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache

from omegaconf import DictConfig

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
    found: dict[str, ScoredSource] = {}
    for entry in pkgutil.iter_modules(folders, f"{__name__}."):
        for kind in vars(importlib.import_module(entry.name)).values():
            if isinstance(kind, type) and issubclass(kind, ScoredSource) and "name" in vars(kind):
                other = found.setdefault(kind.name, kind())
                if type(other) is not kind:
                    raise ValueError(f"{kind} and {type(other)} are both source {kind.name!r}; rename one of them")
    return list(found.items())

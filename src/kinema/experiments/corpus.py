"""Find or make the packed store that a configuration's `data` group describes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from omegaconf import DictConfig

from kinema.data.datasets import ClipDataset, WindowDataset
from kinema.data.prepare import list_files, prepare_store, takes
from kinema.data.store import PackedStore
from kinema.experiments.config import plain
from kinema.motion.skeleton import get_skeleton

_LISTED: ContextVar[dict[str, str] | None] = ContextVar("listed", default=None)
"""What is known of the files of each source; None: every question is answered anew."""


@contextmanager
def files_listed_once() -> Iterator[None]:
    """List the files of each corpus once until the end of the block: what changes meanwhile counts after it.

    A command asks for its corpus at every run and row that it looks up, and HumanML3D is 88,000 files.
    """
    token = _LISTED.set({})
    try:
        yield
    finally:
        _LISTED.reset(token)


def open_corpus(cfg: DictConfig) -> Path:
    """Prepare the corpus where it isn't yet and give its store's folder."""
    return open_split(cfg, cfg.data.options.get("split"))


def open_split(cfg: DictConfig, split: str | None) -> Path:
    """Give the store of the corpus divided by one of its own splits; None is the one that stands in its folder."""
    data = plain(cfg.data)
    options = {**data["options"], "split": split}
    if takes(data["reader"], "fps") or data["fps"] != get_skeleton(data["skeleton"]).fps:
        options["fps"] = data["fps"]
    return prepare_store(
        data["reader"],
        data["source"],
        Path(cfg.paths.stores),
        name=data["name"],
        skeleton=data["skeleton"],
        mirror=data["mirror"],
        listing=_listing(data["source"]),
        **{key: value for key, value in options.items() if value is not None},
    )


def _listing(source: str | None) -> str:
    known = _LISTED.get()
    if source is None or known is None:
        return list_files(source)
    if source not in known:
        known[source] = list_files(source)
    return known[source]


def corpus_label(cfg: DictConfig) -> str:
    """Name the corpus, and the split of it where that isn't its own."""
    split = cfg.data.options.get("split")
    return f"{cfg.data.name}, {split} split" if split else cfg.data.name


def require_captions(store: PackedStore, *splits: str) -> None:
    """Check that the splits have captioned clips of a usable length, before hours are spent on what comes first."""
    for split in splits:
        ClipDataset(store, split)


def require_windows(store: PackedStore, window: int, legacy: bool, *splits: str) -> None:
    """Check that the splits have clips as long as a window."""
    for split in splits:
        WindowDataset(store, split, window, legacy=legacy)


def require_pool(cfg: DictConfig, store: PackedStore) -> None:
    """Check that the split that is scored has a whole pool, before hours are spent on what is to be scored."""
    numbers = cfg.scale.protocol
    entries = len(ClipDataset(store, numbers.split))
    if numbers.leftover == "drop" and entries < numbers.pool:
        smaller = f"scale.protocol.pool={entries} or less" if entries > 1 else "take a split of more"
        raise ValueError(
            f"split {numbers.split!r} of {store.name!r} has {entries} entries, fewer than a pool of {numbers.pool}: "
            f"set scale.protocol.leftover=keep to score them as one smaller pool, or {smaller}; R-precision in another "
            "pool is not comparable with published numbers"
        )

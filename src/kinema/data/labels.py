"""Read what the clips of a corpus show: an action, and the style it is done in."""

from __future__ import annotations

import re
from typing import NamedTuple

from kinema.data.store import PackedStore

LABEL, ACTION, STYLE = "label", "action", "style"
"""The fields of a store that name what a clip shows; a label is `action`, `action|style` or `topic - details`."""

_CAMEL = re.compile(r"(?<=[a-z])(?=[A-Z0-9])|(?<=[0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")


class Shown(NamedTuple):
    """Hold what an entry shows; of a mirrored one the label names the other side."""

    action: str
    style: str | None
    mirrored: bool


def has_labels(store: PackedStore) -> bool:
    """Say whether the corpus names the actions of its clips."""
    return bool({LABEL, ACTION} & {*store.fields})


def require_labels(store: PackedStore) -> None:
    """Raise ValueError, naming the fields there are, if the corpus doesn't say what its clips show."""
    if not has_labels(store):
        raise ValueError(
            f"corpus {store.name!r} doesn't say which actions its clips show: its manifest.json has neither the field "
            f"{LABEL!r} (ACTION or ACTION|STYLE) nor {ACTION!r} (beside {STYLE!r}), only {list(store.fields)}; add "
            "one, or leave out what reads it (source=oracle)"
        )


def label_of(store: PackedStore, clip: int) -> str:
    """Return the label of a clip, put together where its action and style stand apart."""
    if LABEL in store.fields:
        return store.clip_field(clip, LABEL)
    return "|".join(store.clip_field(clip, field) for field in (ACTION, STYLE) if field in store.fields)


def read_label(label: str) -> tuple[str, str | None]:
    """Return action and style of a label, in words, e.g. of `walk-back|sad`, `dance - jetes`, `grabHighR`."""
    action, _, style = label.partition("|")
    action = _CAMEL.sub(" ", action.partition(" - ")[0].replace("-", " ")).lower()
    return " ".join(action.split()), style.replace("-", " ") or None


def shown_by(store: PackedStore, entry: int) -> Shown:
    """Return what an entry's clip shows."""
    return Shown(*read_label(label_of(store, store.entries[entry]["clip"])), bool(store.entries[entry]["mirrored"]))

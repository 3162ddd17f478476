"""Make a frozen text encoder by its name."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType

import torch

from kinema.text.clip import REPOSITORIES, VARIABLES, ClipTextEncoder
from kinema.text.frozen import FrozenTextEncoder
from kinema.text.hashed import HashedTextEncoder
from kinema.text.hidden import PRETRAINED, pretrained_encoder
from kinema.text.minilm import MiniLMTextEncoder, MiniLMWordEncoder


@dataclass(frozen=True)
class Kind:
    """Say how an encoder is made of a folder, where its weights are `published` (None: they come with a package).

    `variable` of the environment names a folder of this machine that holds them.
    """

    make: Callable[[str | Path | None, torch.device | str], FrozenTextEncoder]
    published: str | None = None
    variable: str | None = None

    def here(self) -> str | None:
        """Return where this machine has the published weights, or may find them."""
        return (os.environ.get(self.variable) if self.variable else None) or self.published

    def fetched(self) -> bool:
        """Say whether its weights, of which no folder is named, would come from another machine."""
        return self.published is not None and self.here() == self.published


def _hashed(path: str | Path | None, device: torch.device | str) -> FrozenTextEncoder:
    if path is not None:
        raise ValueError(f"text=hashed has no files; remove text.path={str(path)!r}")
    return HashedTextEncoder(device=device)


ENCODERS: Mapping[str, Kind] = MappingProxyType(
    {
        **{name: Kind(partial(ClipTextEncoder, name), place, VARIABLES[name]) for name, place in REPOSITORIES.items()},
        **{
            name: Kind(partial(pretrained_encoder, name), kind.repository, name.upper())
            for name, kind in PRETRAINED.items()
        },
        "minilm": Kind(MiniLMTextEncoder),
        "minilm_words": Kind(MiniLMWordEncoder),
        "hashed": Kind(_hashed),
    }
)
"""The frozen text encoders by name."""


def build_text_encoder(
    name: str, path: str | Path | None = None, device: torch.device | str = "cpu"
) -> FrozenTextEncoder:
    """Make a frozen text encoder by name; `path` is a local folder, or for CLIP a hub id."""
    if name not in ENCODERS:
        raise ValueError(f"unknown text encoder {name!r}; choose text= one of {', '.join(ENCODERS)}")
    return ENCODERS[name].make(path, device)

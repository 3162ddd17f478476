"""Make a frozen text encoder by its name."""

from __future__ import annotations

from pathlib import Path

import torch

from kinema.text.clip import ClipTextEncoder
from kinema.text.frozen import FrozenTextEncoder
from kinema.text.hashed import HashedTextEncoder
from kinema.text.hidden import PRETRAINED, pretrained_encoder
from kinema.text.minilm import MiniLMTextEncoder, MiniLMWordEncoder

ENCODERS = ("clip_b32", "clip_b32_77", "clip_l14", *PRETRAINED, "minilm", "minilm_words", "hashed")


def build_text_encoder(
    name: str, path: str | Path | None = None, device: torch.device | str = "cpu"
) -> FrozenTextEncoder:
    """Make a frozen text encoder by name; `path` is a local folder, or for CLIP a hub id."""
    if name.startswith("clip_") and name in ENCODERS:
        return ClipTextEncoder(name, path, device)
    if name in PRETRAINED:
        return pretrained_encoder(name, path, device)
    if name == "minilm":
        return MiniLMTextEncoder(path, device)
    if name == "minilm_words":
        return MiniLMWordEncoder(path, device)
    if name == "hashed":
        if path is not None:
            raise ValueError(f"text=hashed has no files; remove text.path={str(path)!r}")
        return HashedTextEncoder(device=device)
    raise ValueError(f"unknown text encoder {name!r}; choose text= one of {', '.join(ENCODERS)}")

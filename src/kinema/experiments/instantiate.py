"""Make live objects of configs and run folders: the machine, trained models, text encoders behind their cache."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig

from kinema.data.store import PackedStore
from kinema.experiments.config import plain
from kinema.runs.parts import load_part
from kinema.text.cache import CachedTextEncoder
from kinema.text.encoders import build_text_encoder
from kinema.text.frozen import FrozenTextEncoder
from kinema.training.machine import Machine


def machine_of(cfg: DictConfig) -> Machine:
    """Return where and how to run; raises ValueError naming an option."""
    return Machine(**plain(cfg.trainer))


def read_model(run: Path, part: str | None = None) -> Any:
    """Load a run's weights on the CPU, without gradients; raises ValueError if they are another part's than `part`."""
    model, _ = load_part(run, part=part)
    return model.requires_grad_(False)


def text_encoder(cfg: DictConfig, device: torch.device | str = "cpu") -> CachedTextEncoder:
    """Return the method's frozen text encoder behind its on-disk cache."""
    return cached(cfg, build_text_encoder(cfg.text.name, path=cfg.text.path, device=device))


def check_text(cfg: DictConfig) -> None:
    """Raise FileNotFoundError or ValueError if the method's text encoder isn't there or is of another width."""
    encoder = build_text_encoder(cfg.text.name, path=cfg.text.path)
    if encoder.dim != cfg.text.dim:
        raise ValueError(
            f"text.dim={cfg.text.dim}, and {encoder.identity} gives {encoder.dim} numbers; choose text= as a whole, or "
            f"set text.dim={encoder.dim}"
        )


def cached(cfg: DictConfig, encoder: FrozenTextEncoder) -> CachedTextEncoder:
    """Put the on-disk cache in front of a text encoder."""
    tokens = "float32" if cfg.generator.reads_tokens else None
    return CachedTextEncoder(encoder, Path(cfg.paths.cache) / "text", tokens=tokens)


def encode_captions(text: CachedTextEncoder, store: PackedStore, *splits: str) -> CachedTextEncoder:
    """Fill the cache with all captions of the splits, in an order that no interruption changes."""
    entries = [int(e) for split in splits for e in store.split_entries(split)]
    text.ensure(sorted({caption.text for entry in entries for caption in store.entry_captions(entry)}))
    return text

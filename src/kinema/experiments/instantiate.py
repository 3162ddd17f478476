"""Make live objects of configs and run folders: model specs, text encoders, evaluators, whole pipelines."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from omegaconf import DictConfig
from torch import nn

from kinema.data.store import PackedStore
from kinema.experiments.config import plain
from kinema.experiments.stages import Stage
from kinema.runs.parts import load_part
from kinema.text.cache import CachedTextEncoder
from kinema.text.encoders import build_text_encoder
from kinema.text.frozen import FrozenTextEncoder
from kinema.text.tokens import TokenTable, clip_tokens
from kinema.text.words import WordVectors, word_vectors


def model_spec(cfg: DictConfig, stage: Stage) -> dict[str, Any]:
    """Return the plain spec that kinema.runs.build makes the stage's model of."""
    node = plain(stage.config(cfg))
    spec = dict(node["model"])
    if "sampling" in node:
        spec["sampling"] = node["sampling"]
    if stage.name == "matching":
        spec["word_width"] = vocabulary(cfg, stage).width
    if stage.name == "contrastive":
        spec["token_width"] = vocabulary(cfg, stage).embedding.shape[1]
    return spec


def read_model(run: Path) -> tuple[nn.Module, dict[str, Any]]:
    """Load a run's selected weights on the CPU, in eval mode and without gradients."""
    model, meta = load_part(run)
    return model.requires_grad_(False), meta


def text_encoder(cfg: DictConfig, device: str = "cpu") -> CachedTextEncoder:
    """Return the method's frozen text encoder behind its on-disk cache."""
    return cached(cfg, build_text_encoder(cfg.text.name, path=cfg.text.path, device=device))


def cached(cfg: DictConfig, encoder: FrozenTextEncoder) -> CachedTextEncoder:
    """Put the on-disk cache in front of a text encoder."""
    tokens = "float32" if cfg.generator.reads_tokens else None
    return CachedTextEncoder(encoder, Path(cfg.paths.cache) / "text", tokens=tokens)


def encode_captions(text: CachedTextEncoder, store: PackedStore, *splits: str) -> CachedTextEncoder:
    """Fill the cache with all captions of the splits, in an order that no interruption changes."""
    entries = [int(e) for split in splits for e in store.split_entries(split)]
    text.ensure(sorted({caption.text for entry in entries for caption in store.entry_captions(entry)}))
    return text


def vocabulary(cfg: DictConfig, stage: Stage) -> WordVectors | TokenTable:
    """Return an evaluator's word vectors (T2M-style) or token table (CLIP-style); its models' width follows them."""
    if stage.name == "contrastive":
        return clip_tokens(cfg.evaluator.tokens, path=cfg.evaluator.tokens_path)
    return word_vectors(cfg.evaluator.words, path=cfg.evaluator.words_path)


def attach_text(cfg: DictConfig, stage: Stage, model: nn.Module) -> str:
    """Attach an evaluator's vocabulary; give its identity, which results name."""
    table = vocabulary(cfg, stage)
    model.attach(table)
    return table.identity

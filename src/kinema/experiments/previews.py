"""Draw sample motions while a generator trains."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import torch
from omegaconf import DictConfig

from kinema.data.datasets import ClipDataset
from kinema.data.store import PackedStore
from kinema.generators import Generator
from kinema.motion.view.html import save_html
from kinema.pipeline import TextToMotion
from kinema.text.cache import CachedTextEncoder
from kinema.tokenizers import MotionTokenizer


def sample_drawer(
    cfg: DictConfig, store: PackedStore, tokenizer: MotionTokenizer, text: CachedTextEncoder
) -> Callable[[Generator, Path], Path]:
    """Return a callable that writes a page of motions for the same few validation captions at every call."""
    clips = ClipDataset(store, "val")
    count = min(cfg.callbacks.sample_prompts, len(clips))
    entries = [int(clips.entries[i * len(clips) // count]) for i in range(count)]
    texts = [store.entry_captions(e)[0].text for e in entries]
    frames = [int(store.entries["frames"][e]) for e in entries]

    @torch.no_grad()
    def draw(model: Generator, path: Path) -> Path:
        pipeline = TextToMotion(tokenizer.to(next(model.parameters()).device), model, text)
        lengths = [min(count, pipeline.max_frames) for count in frames]
        motions = pipeline.generate(texts, lengths, seed=cfg.seed)
        path.parent.mkdir(parents=True, exist_ok=True)
        save_html(motions, path)
        return path

    return draw

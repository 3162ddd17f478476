"""Embed the training split once for a judge, to find out what of it a method repeats."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from kinema.data.collate import collate
from kinema.data.datasets import Item, crop_frames
from kinema.data.store import PackedStore
from kinema.evaluation.cache import EmbeddingCache
from kinema.evaluation.encoders.base import TextMotionEvaluator
from kinema.evaluation.metrics.neighbours import isolation
from kinema.evaluation.sources import UNIT
from kinema.types import MotionBatch


@dataclass(frozen=True)
class TrainingSet:
    """Hold embeddings of training motions, and the distance of each to the nearest one of another origin.

    Mirror images and parts of one clip have one origin: they lie near each other by construction.
    """

    embeddings: Float[Tensor, "n e"]
    isolation: Float[Tensor, " n"]

    @classmethod
    @torch.no_grad()
    def embedded(cls, store: PackedStore, evaluator: TextMotionEvaluator, cache: EmbeddingCache) -> TrainingSet:
        """Embed every entry of the train split, whole, or read what was embedded before."""
        shelf = cache.training(evaluator.identity())
        device = evaluator.representation.mean.device
        entries = store.split_entries("train", captions_required=False)
        # Batches of about one length hold little padding.
        entries = entries[np.argsort(store.entries["frames"][entries], kind="stable")]
        embeddings = shelf.get("embeddings", lambda: embed(store, entries, evaluator.eval()), device)
        origins = torch.from_numpy(origins_of(store, entries)).to(embeddings.device)
        found = cls(embeddings, shelf.get("isolation", lambda: isolation(embeddings, origins), device))
        shelf.save()
        return found


def embed(
    store: PackedStore, entries: Int[np.ndarray, " n"], evaluator: TextMotionEvaluator, size: int = 64
) -> Float[Tensor, "n e"]:
    """Embed entries from their first frame to the last whole unit."""
    device = evaluator.representation.mean.device
    parts = [
        evaluator.embed_motion(_batch(store, entries[i : i + size], evaluator.representation.kind).to(device))
        for i in range(0, len(entries), size)
    ]
    return torch.cat(parts)


def origins_of(store: PackedStore, entries: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """Number the clips that entries come from; a mirrored clip is its original's."""
    clips = store.entries["clip"][entries]
    names = [store.clip_name(clip).removeprefix("M" if store.clips["mirrored"][clip] else "") for clip in clips]
    return np.unique(names, return_inverse=True)[1]


def _batch(store: PackedStore, entries: Int[np.ndarray, " n"], dims: str) -> MotionBatch:
    width = store.skeleton.width_of(dims)
    frames = [crop_frames(int(store.entries["frames"][entry]), UNIT)[0] for entry in entries]
    return collate(
        [
            Item(store.frames_of(int(entry))[:count, :width], int(entry), 0, store.entry_name(int(entry)))
            for entry, count in zip(entries, frames, strict=True)
        ]
    )

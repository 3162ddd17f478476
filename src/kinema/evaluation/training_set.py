"""Embed the training split once for a judge, to find out what of it a method repeats."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from kinema.data.collate import collate
from kinema.data.datasets import Item, crop_frames
from kinema.data.leakage import entry_origins
from kinema.data.origin import ORIGIN
from kinema.data.store import PackedStore
from kinema.evaluation.cache import EmbeddingCache
from kinema.evaluation.encoders.base import TextMotionEvaluator
from kinema.evaluation.metrics.neighbours import isolation
from kinema.evaluation.scores import metric_device
from kinema.evaluation.sources import UNIT
from kinema.types import MotionBatch


@dataclass(frozen=True)
class TrainingSet:
    """Hold embeddings of training motions, and the distance of each to the nearest one of other frames.

    Mirror images, and clips and parts that overlap in their take, lie near each other by construction.
    """

    embeddings: Float[Tensor, "n e"]
    isolation: Float[Tensor, " n"]

    @classmethod
    @torch.no_grad()
    def embedded(cls, store: PackedStore, evaluator: TextMotionEvaluator, cache: EmbeddingCache) -> TrainingSet:
        """Embed every entry of the train split, whole, or read what was embedded before."""
        shelf = cache.training(evaluator.identity())
        device = metric_device(evaluator.representation.mean.device)
        entries = store.split_entries("train", captions_required=False)
        # Batches of about one length hold little padding.
        entries = entries[np.argsort(store.entries["frames"][entries], kind="stable")]
        origins = origins_of(store, entries)
        # The store's hash names its content, but not what is known of takes.
        key = f"isolation-{hashlib.sha256(origins.tobytes()).hexdigest()[:24]}"
        embeddings = shelf.get("embeddings", lambda: embed(store, entries, evaluator.eval()), device)
        known = torch.from_numpy(origins).to(device)
        found = cls(embeddings, shelf.get(key, lambda: isolation(embeddings, known), device))
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


def origins_of(store: PackedStore, entries: Int[np.ndarray, " n"]) -> Int[np.ndarray, "n 3"]:
    """Return the take of each entry by number, and its frames there; a clip of no known take is a take of its own.

    A mirrored clip is of the frames of its original.
    """
    rows = entry_origins(store)[entries]
    found = np.stack([rows[name].astype(np.int64) for name in ORIGIN.names or ()], axis=1)
    lost = rows["take"] < 0
    clips = store.entries["clip"][entries[lost]]
    names = [store.clip_name(clip).removeprefix("M" if store.clips["mirrored"][clip] else "") for clip in clips]
    start = store.entries["offset"][entries[lost]] - store.clips["offset"][clips]
    takes = rows["take"].max(initial=-1) + 1 + np.unique(names, return_inverse=True)[1]
    found[lost] = np.stack([takes, start, start + store.entries["frames"][entries[lost]]], axis=1)
    return found


def _batch(store: PackedStore, entries: Int[np.ndarray, " n"], dims: str) -> MotionBatch:
    width = store.skeleton.width_of(dims)
    frames = [crop_frames(int(store.entries["frames"][entry]), UNIT)[0] for entry in entries]
    return collate(
        [
            Item(store.frames_of(int(entry))[:count, :width], int(entry), 0, store.entry_name(int(entry)))
            for entry, count in zip(entries, frames, strict=True)
        ]
    )

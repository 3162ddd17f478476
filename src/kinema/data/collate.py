"""Put items into a batch."""

from __future__ import annotations

import numpy as np
import torch

from kinema.data.datasets import Item
from kinema.types import MotionBatch


def collate(items: list[Item]) -> MotionBatch:
    """Stack crops into a batch, padded with zeros to the longest of them."""
    lengths = [len(item.features) for item in items]
    features = np.zeros((len(items), max(lengths), items[0].features.shape[1]), dtype=np.float32)
    for row, item in zip(features, items, strict=True):
        row[: len(item.features)] = item.features
    return MotionBatch(
        features=torch.from_numpy(features),
        lengths=torch.tensor(lengths),
        entries=torch.tensor([item.entry for item in items]),
        starts=torch.tensor([item.start for item in items]),
        captions=[item.caption for item in items if item.caption is not None],
        clip_ids=[item.name for item in items],
    )

"""Answer several batches at once: motions of like length are made beside each other, and little is padding."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import torch
from jaxtyping import Int
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from kinema.pipeline.arguments import BATCH
from kinema.types import MotionBatch

Asked = tuple[MotionBatch, Int[Tensor, "_"]]
"""A batch whose captions are to be answered, and a seed per row."""


def by_length(
    asked: Sequence[Asked], make: Callable[[MotionBatch, Tensor], MotionBatch], batch_size: int = BATCH
) -> list[MotionBatch]:
    """Answer all rows by `make`, `batch_size` to a batch: where there are several, the longest first.

    Returned in the order they came in.
    """
    if not asked:
        return []
    rows, seeds = join([batch for batch, _ in asked]), torch.cat([drawn for _, drawn in asked])
    order = torch.arange(len(seeds), device=rows.lengths.device)
    if len(order) > batch_size:
        order = torch.argsort(rows.lengths, descending=True, stable=True)
    features: dict[int, Tensor] = {}
    lengths = torch.zeros_like(rows.lengths)
    for part in order.split(batch_size):
        made = make(select(rows, part), seeds[part.to(seeds.device)])
        features |= zip(part.tolist(), made.features, strict=True)
        lengths[part] = made.lengths.to(lengths)
    found, first = [], 0
    for batch, _ in asked:
        own = lengths[first : first + len(batch.lengths)]
        motions = [features[first + i][:length] for i, length in enumerate(own.tolist())]
        found.append(replace(batch, features=pad_sequence(motions, batch_first=True), lengths=own))
        first += len(own)
    return found


def select(batch: MotionBatch, rows: Int[Tensor, " n"]) -> MotionBatch:
    """Take some rows of a batch, padded to the longest of them."""
    chosen, lengths = rows.tolist(), batch.lengths[rows]
    return replace(
        batch,
        features=batch.features[rows, : max(lengths.tolist(), default=0)],
        lengths=lengths,
        entries=None if batch.entries is None else batch.entries[rows],
        starts=None if batch.starts is None else batch.starts[rows],
        captions=[batch.captions[i] for i in chosen],
        clip_ids=[batch.clip_ids[i] for i in chosen] if batch.clip_ids else [],
    )


def join(batches: Sequence[MotionBatch]) -> MotionBatch:
    """Put batches below each other, padded to the longest of their rows."""
    entries, starts = ([getattr(batch, name) for batch in batches] for name in ("entries", "starts"))
    return MotionBatch(
        features=pad_sequence([row for batch in batches for row in batch.features], batch_first=True),
        lengths=torch.cat([batch.lengths for batch in batches]),
        entries=None if any(each is None for each in entries) else torch.cat(entries),
        starts=None if any(each is None for each in starts) else torch.cat(starts),
        captions=[caption for batch in batches for caption in batch.captions],
        clip_ids=[name for batch in batches for name in batch.clip_ids] if all(b.clip_ids for b in batches) else [],
    )

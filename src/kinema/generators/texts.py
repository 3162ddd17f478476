"""Take texts away from samples, for training without them and for guidance."""

from __future__ import annotations

from dataclasses import replace

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from kinema.types import TextFeatures


def without_text(text: TextFeatures, drop: Bool[Tensor, " b"] | None = None) -> TextFeatures:
    """Zero the features of the samples in `drop` (None: of all): the empty condition."""
    if drop is None:
        drop = torch.ones_like(text.pooled[:, 0], dtype=torch.bool)
    tokens = None if text.tokens is None else text.tokens.masked_fill(drop[:, None, None], 0.0)
    return replace(text, pooled=text.pooled.masked_fill(drop[:, None], 0.0), tokens=tokens)


def without_words(text: TextFeatures, drop: Bool[Tensor, " b"] | None = None) -> TextFeatures:
    """Zero the pooled vector of the samples in `drop` (None: of all) and hide their words, how many they were too."""
    text = without_text(text, drop)
    if text.token_mask is None:
        return text
    hidden = torch.ones_like(text.token_mask) if drop is None else drop[:, None]
    return replace(text, token_mask=text.token_mask & ~hidden)


def check_guidance(condition_drop: float, **scales: float) -> None:
    """Refuse options of guidance that need the empty text of a model that was trained on none."""
    for name, scale in scales.items():
        if scale != 1 and not condition_drop:
            raise ValueError(
                f"{name} is {scale}, but condition_drop=0 gave this model no empty text to be guided from; use {name}=1"
            )


def some(text: TextFeatures, rows: Bool[Tensor, " b"]) -> TextFeatures:
    """Take the samples where `rows` is True."""
    return _taken(text, rows.nonzero().squeeze(1))


def repeated(text: TextFeatures, times: int) -> TextFeatures:
    """Take every sample `times` times, one after the other."""
    rows = torch.arange(len(text.pooled), device=text.pooled.device)
    return _taken(text, rows.repeat_interleave(times))


def _taken(text: TextFeatures, rows: Int[Tensor, " n"]) -> TextFeatures:
    own = rows.tolist()
    return TextFeatures(
        texts=[text.texts[i] for i in own],
        pooled=text.pooled[rows],
        tokens=None if text.tokens is None else text.tokens[rows],
        token_mask=None if text.token_mask is None else text.token_mask[rows],
        clip_ids=[text.clip_ids[i] for i in own] if text.clip_ids else [],
    )


def beside(text: TextFeatures, other: TextFeatures) -> TextFeatures:
    """Lay two batches of the same texts behind each other, with words and without."""

    def both(a: Tensor | None, b: Tensor | None) -> Tensor | None:
        return None if a is None or b is None else torch.cat((a, b))

    return TextFeatures(
        texts=text.texts + other.texts,
        pooled=torch.cat((text.pooled, other.pooled)),
        tokens=both(text.tokens, other.tokens),
        token_mask=both(text.token_mask, other.token_mask),
        clip_ids=text.clip_ids + other.clip_ids,
    )
